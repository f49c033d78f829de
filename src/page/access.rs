//! Who may do what at the page: tickets that sign a browser in once, tokens that last.
//!
//! In: requests of people on this computer, secrets that come with requests, the time. Out: secrets, each
//! given away once; grants. Time is the boot's: setting the calendar ends no session and prolongs none, and
//! a new boot ends all. Only the SHA-256 of a secret is kept: whoever reads the file learns none. A
//! secret has 256 random bits, so it is neither guessed nor found by the time that a comparison takes; the
//! comparison is of constant time nevertheless. Pure but for the random numbers.

use cell_machine::orders::Role;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

/// A ticket that is not redeemed within this time is void, s.
pub const TICKET_S: f64 = 120.0;

/// A browser stays signed in for this long, s: a shift.
pub const SESSION_S: f64 = 12.0 * 3600.0;

/// Most tickets and grants at a time; the oldest make room.
const MOST: usize = 256;

/// Longest name of a person, characters.
const NAME_LENGTH: usize = 40;

/// What a person may do, and until when.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grant {
    /// How the person is called.
    pub name: String,
    /// What the person may do.
    pub role: Role,
    /// s since this computer started.
    pub until_boot_s: f64,
}

/// A grant with the fingerprints of its secrets, hex.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Kept {
    sha256: String,
    /// Of the secret that a browser keeps beside its cookie.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    page_sha256: Option<String>,
    grant: Grant,
}

/// The two secrets of a browser's session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Secrets {
    /// In the cookie, which a browser sends to every port of the computer.
    pub cookie: String,
    /// In the storage of the page's own origin, which no other port can read.
    pub page: String,
}

/// A person who is signed in.
#[derive(Clone, Debug, PartialEq)]
pub struct Person {
    /// What the person may do.
    pub grant: Grant,
    /// Which of the person's sessions; no secret.
    pub session: String,
}

/// What signs one browser in, once.
#[derive(Clone, Debug)]
struct Ticket {
    kept: Kept,
    /// The user whose browser alone it is for.
    user: Option<u32>,
}

/// What comes of a ticket.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Redeemed {
    /// The secrets of the session.
    Session(Secrets),
    /// It was used, is too old, or never was.
    Void,
    /// It counts for a browser of another user, and still does.
    OfAnotherUser,
}

/// All tickets and grants.
#[derive(Clone, Debug, Default)]
pub struct Access {
    /// The boot of this computer that the times count from.
    boot: String,
    tickets: Vec<Ticket>,
    grants: Vec<Kept>,
}

/// The file of the grants.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    version: u32,
    /// The boot that the grants belong to.
    boot: String,
    grants: Vec<Kept>,
}

impl Access {
    /// The grants of an earlier daemon of this boot; none where the text is no such file.
    pub fn of_file(text: &str, boot: &str, now_boot_s: f64) -> Access {
        let of_now = |file: &File| file.version == 2 && file.boot == boot && !boot.is_empty();
        let file = serde_json::from_str::<File>(text).ok().filter(of_now);
        let mut access = Access {
            boot: boot.to_string(),
            tickets: Vec::new(),
            grants: file.map(|file| file.grants).unwrap_or_default(),
        };
        access.forget(now_boot_s);
        access
    }

    /// The grants, for a file that only the daemon reads.
    pub fn file(&self) -> String {
        let file = File { version: 2, boot: self.boot.clone(), grants: self.grants.clone() };
        serde_json::to_string_pretty(&file).expect("grants have string keys only")
    }

    /// A ticket for one browser, of this user alone where one is named; `grant.until_boot_s` is that of the
    /// session it leads to.
    ///
    /// # Errors
    /// The system gives no random numbers.
    pub fn ticket(
        &mut self,
        grant: Grant,
        user: Option<u32>,
        now_boot_s: f64,
    ) -> Result<String, getrandom::Error> {
        self.forget(now_boot_s);
        let secret = secret()?;
        // Until when the ticket counts is in the grant; what it leads to lasts as long as a session.
        let ticket = Grant { until_boot_s: now_boot_s + TICKET_S, ..grant };
        push(
            &mut self.tickets,
            Ticket { kept: Kept { sha256: fingerprint(&secret), page_sha256: None, grant: ticket }, user },
        );
        Ok(secret)
    }

    /// A session for a ticket, once; `user`: whose browser brings it, where that is known.
    ///
    /// # Errors
    /// The system gives no random numbers.
    pub fn redeem(
        &mut self,
        ticket: &str,
        user: Option<u32>,
        now_boot_s: f64,
    ) -> Result<Redeemed, getrandom::Error> {
        self.forget(now_boot_s);
        let Some(index) = find(self.tickets.iter().map(|ticket| &ticket.kept), ticket) else {
            return Ok(Redeemed::Void);
        };
        if self.tickets[index].user.is_some_and(|own| user != Some(own)) {
            return Ok(Redeemed::OfAnotherUser);
        }
        let Grant { name, role, .. } = self.tickets.remove(index).kept.grant;
        let grant = Grant { name, role, until_boot_s: now_boot_s + SESSION_S };
        let (cookie, page) = (secret()?, secret()?);
        let page_sha256 = Some(fingerprint(&page));
        push(&mut self.grants, Kept { sha256: fingerprint(&cookie), page_sha256, grant });
        Ok(Redeemed::Session(Secrets { cookie, page }))
    }

    /// Whether a browser's session comes with the secret of its page; `None`: it is no browser's, but a
    /// program's token.
    pub fn is_of_page(&self, secret: &str, page: &str) -> Option<bool> {
        let kept = self.grants[find(&self.grants, secret)?].page_sha256.as_ref()?;
        Some(bool::from(kept.as_bytes().ct_eq(fingerprint(page).as_bytes())))
    }

    /// A secret that counts until the grant ends.
    ///
    /// # Errors
    /// The system gives no random numbers.
    pub fn grant(&mut self, grant: Grant) -> Result<String, getrandom::Error> {
        let secret = secret()?;
        push(&mut self.grants, Kept { sha256: fingerprint(&secret), page_sha256: None, grant });
        Ok(secret)
    }

    /// Who comes with this secret.
    pub fn person(&self, secret: &str, now_boot_s: f64) -> Option<Person> {
        let kept = &self.grants[find(&self.grants, secret)?];
        let session = kept.sha256.chars().take(12).collect();
        (kept.grant.until_boot_s > now_boot_s).then(|| Person { grant: kept.grant.clone(), session })
    }

    /// Ends the session of this secret.
    pub fn end(&mut self, secret: &str) {
        if let Some(index) = find(&self.grants, secret) {
            self.grants.remove(index);
        }
    }

    /// Ends all that one name may do; how many sessions, tokens and links that were.
    pub fn end_all_of(&mut self, name: &str) -> usize {
        let before = self.tickets.len() + self.grants.len();
        let others = |kept: &Kept| kept.grant.name != name;
        self.tickets.retain(|ticket| others(&ticket.kept));
        self.grants.retain(others);
        before - self.tickets.len() - self.grants.len()
    }

    fn forget(&mut self, now_boot_s: f64) {
        let counts = |kept: &Kept| kept.grant.until_boot_s > now_boot_s;
        self.tickets.retain(|ticket| counts(&ticket.kept));
        self.grants.retain(counts);
    }
}

fn push<T>(list: &mut Vec<T>, item: T) {
    if list.len() >= MOST {
        list.remove(0);
    }
    list.push(item);
}

/// All are compared, whether one was found or not.
fn find<'a>(list: impl IntoIterator<Item = &'a Kept>, secret: &str) -> Option<usize> {
    let wanted = fingerprint(secret);
    let mut found = None;
    for (index, kept) in list.into_iter().enumerate() {
        if bool::from(kept.sha256.as_bytes().ct_eq(wanted.as_bytes())) {
            found = Some(index);
        }
    }
    found
}

fn fingerprint(secret: &str) -> String {
    hex(&Sha256::digest(secret.as_bytes()))
}

fn secret() -> Result<String, getrandom::Error> {
    let mut bytes = [0; 32];
    getrandom::fill(&mut bytes)?;
    Ok(hex(&bytes))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A name as it is shown: without control characters, and not longer than fits a line.
pub fn plain_name(name: &str) -> Option<String> {
    let plain: String = name.chars().filter(|c| !c.is_control()).take(NAME_LENGTH).collect();
    let plain = plain.trim();
    (!plain.is_empty()).then(|| plain.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: f64 = 5_000.0;
    const BOOT: &str = "8b1f0d3e";

    fn anna(until_boot_s: f64) -> Grant {
        Grant { name: "anna".into(), role: Role::Operate, until_boot_s }
    }

    #[test]
    fn a_ticket_signs_in_once_and_not_for_ever() {
        let mut access = Access::default();
        let ticket = access.ticket(anna(0.0), None, NOW).unwrap();
        assert_eq!(access.person(&ticket, NOW), None, "a ticket is no session");
        let redeemed = access.redeem(&ticket, None, NOW + 1.0).unwrap();
        let Redeemed::Session(secrets) = redeemed else { panic!("in time: {redeemed:?}") };
        let Secrets { cookie: session, page } = secrets;
        assert_eq!(access.is_of_page(&session, &page), Some(true));
        assert_eq!(access.is_of_page(&session, &session), Some(false));
        assert!(access.is_of_page(&page, &page).is_none() && access.person(&page, NOW + 2.0).is_none());
        assert_eq!(access.redeem(&ticket, None, NOW + 2.0).unwrap(), Redeemed::Void, "once");
        let person = access.person(&session, NOW + 2.0).expect("signed in");
        assert_eq!((person.grant.name.as_str(), person.grant.role), ("anna", Role::Operate));
        assert_eq!(access.person(&session, NOW + 2.0 + SESSION_S), None, "a shift is over");
        let late = access.ticket(anna(0.0), None, NOW).unwrap();
        assert_eq!(access.redeem(&late, None, NOW + TICKET_S + 1.0).unwrap(), Redeemed::Void, "too late");
        access.end(&session);
        assert_eq!(access.person(&session, NOW + 2.0), None, "signed out");
        let (token, link) =
            (access.grant(anna(NOW + 1e6)).unwrap(), access.ticket(anna(0.0), None, NOW).unwrap());
        let other = access.grant(Grant { name: "ben".into(), ..anna(NOW + 1e6) }).unwrap();
        assert_eq!(access.end_all_of("anna"), 2, "the link that was too late is gone already");
        assert_eq!(access.person(&token, NOW), None, "taken back");
        assert_eq!(access.redeem(&link, None, NOW).unwrap(), Redeemed::Void, "and a link that was not used");
        assert!(access.person(&other, NOW).is_some() && access.end_all_of("anna") == 0);
    }

    #[test]
    fn what_is_for_the_browser_of_one_user_does_not_count_for_that_of_another() {
        let mut access = Access::default();
        let link = access.ticket(anna(0.0), Some(1000), NOW).unwrap();
        for other in [Some(1001), Some(0), None] {
            assert_eq!(access.redeem(&link, other, NOW).unwrap(), Redeemed::OfAnotherUser, "{other:?}");
        }
        assert!(
            matches!(access.redeem(&link, Some(1000), NOW).unwrap(), Redeemed::Session(_)),
            "still counts"
        );
    }

    #[test]
    fn a_restart_keeps_grants_and_their_file_has_no_secret() {
        let mut access = Access::of_file("", BOOT, NOW);
        let token = access.grant(anna(NOW + 100.0)).unwrap();
        assert_eq!(access.is_of_page(&token, ""), None, "a token has no page");
        let file = access.file();
        assert!(!file.contains(&token) && file.contains("anna"));
        assert!(Access::of_file(&file, BOOT, NOW).person(&token, NOW).is_some());
        assert!(Access::of_file(&file, BOOT, NOW + 101.0).person(&token, NOW).is_none(), "outlived");
        for other in ["9c2a1e4f", ""] {
            assert!(Access::of_file(&file, other, 1.0).person(&token, 1.0).is_none(), "boot {other:?}");
        }
        for broken in ["", "{}", "[1]", &file.replace("\"version\": 2", "\"version\": 1")] {
            assert!(Access::of_file(broken, BOOT, NOW).person(&token, NOW).is_none(), "{broken}");
        }
    }

    #[test]
    fn what_is_no_secret_opens_nothing_and_the_list_is_bounded() {
        let mut access = Access::default();
        let first = access.grant(anna(NOW + 1e6)).unwrap();
        for wrong in ["", "0", &first[..63], &format!("{first}0"), &first.to_uppercase()] {
            assert!(access.person(wrong, NOW).is_none() || *wrong == first, "{wrong}");
        }
        for _ in 0..MOST {
            access.grant(anna(NOW + 1e6)).unwrap();
        }
        assert_eq!(access.grants.len(), MOST);
        assert!(access.person(&first, NOW).is_none(), "the oldest made room");
    }

    #[test]
    fn names_are_shown_on_one_line() {
        assert_eq!(plain_name(" an\u{1b}[2Jna\n ").as_deref(), Some("an[2Jna"));
        assert_eq!(plain_name("\u{7}"), None);
        assert_eq!(plain_name(&"x".repeat(99)).map(|name| name.len()), Some(NAME_LENGTH));
    }
}
