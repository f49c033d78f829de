//! What one cell decides in single situations that seeded schedules do not come across: equal ids, jobs that
//! were given away before anything moved, cancellations that were refused, jobs that began meanwhile.
//!
//! In: inputs to one [`Agent`]. Out: its effects.

#![allow(clippy::unwrap_used, reason = "helpers of tests: an unwrap that fails is the test that fails")]

use cell_fleet::agent::Agent;
use cell_fleet::payloads::{CellState, Claim, ClaimState, Job, Outcome, VERSION, Wish, encode};
use cell_fleet::subjects::{Fleet, Key, Lane, Priority, Target};
use cell_fleet::values::{At, Effect, Entry, Input, Kept, Local, Settle, Unread, Who, Written};
use cell_fleet::world::Settings;
use cell_values::time::{Duration, Timestamp};

struct Bench {
    agent: Agent,
    now: Timestamp,
}

impl Bench {
    fn new(entries: Vec<Entry>) -> Bench {
        let agent = Agent::new(Fleet::new("plant").unwrap(), Settings::new("c1", &[]), entries);
        Bench { agent, now: Timestamp::from_nanos(1_000_000_000) }
    }

    /// An armed, idle cell with a connection.
    fn ready() -> Bench {
        let mut bench = Bench::new(Vec::new());
        bench.take(Input::Connected);
        bench.after(1);
        bench.take(Input::Cells(Some(vec![("c1".into(), CellState::default(), 1e9)])));
        bench.take(Input::Ready(true));
        bench
    }

    fn take(&mut self, input: Input) -> Vec<Effect> {
        self.agent.handle(At { now: self.now, unix_s: 1e9 }, input);
        std::iter::from_fn(|| self.agent.poll()).collect()
    }

    fn after(&mut self, seconds: u64) -> Vec<Effect> {
        self.now += Duration::from_secs(seconds);
        self.take(Input::Time)
    }

    fn pulled(&mut self, job: &Job, token: u64) -> Vec<Effect> {
        let subject = Fleet::new("plant").unwrap().job(&lane(), "anna");
        let payload = encode(job).unwrap();
        self.take(Input::Pulled { token, subject, sequence: token, delivered: 1, payload })
    }

    fn read(&mut self, claim: Option<Claim>) -> Vec<Effect> {
        let found = Ok(claim.map(|claim| (Box::new(claim), 3)));
        self.take(Input::Read { job: "tidy".into(), found })
    }
}

fn lane() -> Lane {
    Lane { priority: Priority::Normal, target: Target::any() }
}

fn job(text: &str) -> Job {
    Job::new("tidy", text, 0.0)
}

fn claim(job: Job, state: ClaimState, cell: &str) -> Claim {
    Claim::new(job, &lane(), "anna", state, cell, 1e9)
}

/// A job that the own database says was begun, after a restart.
fn begun_before() -> Entry {
    Entry {
        job: job("a"),
        target: "any".into(),
        priority: "normal".into(),
        by: "anna".into(),
        kept: Kept::Begun,
        begun_here: true,
        outcome: None,
    }
}

fn hands_in(effects: &[Effect]) -> bool {
    effects.iter().any(|effect| matches!(effect, Effect::HandIn(_)))
}

fn reads(effects: &[Effect]) -> bool {
    effects.iter().any(|effect| matches!(effect, Effect::Read(_)))
}

#[test]
fn a_second_job_with_an_id_is_set_aside_and_the_cell_goes_on() {
    let mut bench = Bench::ready();
    assert!(reads(&bench.pulled(&job("b"), 1)));
    let effects = bench.read(Some(claim(job("a"), ClaimState::Ended, "c2")));
    let written = effects.iter().find_map(|effect| match effect {
        Effect::Write { claim, over: None, .. } if claim.state == ClaimState::Aside => Some(claim.clone()),
        _ => None,
    });
    let written = written.expect("set aside").job.id;
    assert!(written.starts_with("tidy."), "{written}");
    let effects = bench.take(Input::Written { who: Who::Hand, job: written, outcome: Written::Done(1) });
    assert!(effects.contains(&Effect::Settle(1, Settle::Done)), "{effects:?}");
    let effects = bench.after(1);
    let next = bench.pulled(&Job::new("next", "c", 0.0), 2);
    assert!(reads(&next), "{effects:?} {next:?}");
}

#[test]
fn a_second_job_with_the_id_of_the_one_in_hand_stays_in_its_queue() {
    let mut bench = Bench::new(vec![begun_before()]);
    bench.take(Input::Connected);
    let effects = bench.pulled(&job("b"), 1);
    let back = |effect: &Effect| matches!(effect, Effect::Settle(1, Settle::Back(_)));
    assert!(effects.iter().any(back), "{effects:?}");
    let effects = bench.pulled(&job("a"), 2);
    assert!(effects.contains(&Effect::Settle(2, Settle::Done)), "the same once more: {effects:?}");
}

#[test]
fn what_was_begun_and_is_not_in_the_spool_goes_there_only_while_its_claim_is_ours() {
    let ours = || claim(job("a"), ClaimState::Begun, "c1");
    let given = || Claim { job: Job { epoch: 2, ..job("a") }, cell: "c2".into(), ..ours() };
    for (found, goes_on) in [(Some(ours()), true), (None, true), (Some(given()), false)] {
        let mut bench = Bench::new(vec![begun_before()]);
        bench.after(1);
        let effects = bench.take(Input::Local { job: "tidy".into(), state: Local::Unknown });
        assert!(!hands_in(&effects), "not without the network: {effects:?}");
        assert!(!hands_in(&bench.after(60)));
        assert!(bench.agent.next_wake() > bench.now, "nothing is due before there is a network");
        bench.take(Input::Connected);
        bench.after(1);
        assert_eq!(hands_in(&bench.read(found.clone())), goes_on, "{found:?}");
        // A disk that was full: the claim is read again before the next attempt.
        if goes_on {
            bench.take(Input::HandedIn { job: "tidy".into(), result: Err("full".into()) });
            let effects = bench.after(3);
            assert!(!hands_in(&effects), "{effects:?}");
            assert!(reads(&bench.after(1)) || reads(&effects));
            assert!(!hands_in(&bench.read(Some(given()))));
        }
    }
}

#[test]
fn a_cancellation_is_ordered_again_until_the_job_has_ended() {
    let mut bench = Bench::new(vec![begun_before()]);
    bench.take(Input::Connected);
    let key = Key::Cancel { job: "tidy".into(), by: "anna".into() };
    let wish = Wish { version: VERSION, epoch: 0, target: None, begun: false, unix_s: 0.0 };
    bench.take(Input::Wish { key, wish: Some(wish) });
    let mut ordered = 0;
    for _ in 0..4 {
        let open = bench.take(Input::Local { job: "tidy".into(), state: Local::Open });
        ordered += open.iter().filter(|effect| matches!(effect, Effect::Cancel { .. })).count();
        bench.after(5);
    }
    assert_eq!(ordered, 4);
    bench.take(Input::Local { job: "tidy".into(), state: Local::Ended(Outcome::default()) });
    let open = bench.take(Input::Local { job: "tidy".into(), state: Local::Open });
    assert!(!open.iter().any(|effect| matches!(effect, Effect::Cancel { .. })), "{open:?}");
}

#[test]
fn a_job_that_began_meanwhile_is_given_away_by_who_knows_it_alone() {
    for (state, begun, granted) in [
        (ClaimState::Claimed, false, true),
        (ClaimState::Begun, false, false),
        (ClaimState::Ended, false, false),
        (ClaimState::Begun, true, true),
    ] {
        let mut bench = Bench::ready();
        bench.after(1);
        let given = claim(job("a"), state, "c2");
        bench.take(Input::Claim { claim: Box::new(given), revision: 3, unix_s: 1e9 });
        bench.take(Input::ClaimsKnown);
        let key = Key::Give { job: "tidy".into(), by: "anna".into() };
        let wish = Wish { version: VERSION, epoch: 1, target: None, begun, unix_s: 0.0 };
        let mut effects = bench.take(Input::Wish { key, wish: Some(wish) });
        effects.extend(bench.after(2));
        let gives = |effect: &Effect| matches!(effect, Effect::Write { claim, .. } if claim.job.epoch == 2);
        assert_eq!(effects.iter().any(gives), granted, "{state:?} {begun}: {effects:?}");
    }
}

#[test]
fn a_claim_of_another_version_leaves_its_job_to_others_and_the_cell_goes_on() {
    let mut bench = Bench::ready();
    assert!(reads(&bench.pulled(&job("b"), 1)));
    let effects = bench.take(Input::Read { job: "tidy".into(), found: Err(Unread::Foreign) });
    let back =
        |effect: &Effect| matches!(effect, Effect::Settle(1, Settle::Back(wait)) if wait.as_secs() > 60);
    assert!(effects.iter().any(back), "{effects:?}");
    assert!(effects.contains(&Effect::Pull(true)), "the next one: {effects:?}");
    // What was claimed here may be under way: it is neither begun nor forgotten.
    let claimed = Entry { kept: Kept::Claimed, begun_here: false, ..begun_before() };
    let mut bench = Bench::new(vec![claimed]);
    bench.take(Input::Connected);
    bench.take(Input::Ready(true));
    let effects = bench.take(Input::Read { job: "tidy".into(), found: Err(Unread::Foreign) });
    assert!(
        !effects.iter().any(|effect| matches!(effect, Effect::Keep(_) | Effect::Pull(true))),
        "{effects:?}"
    );
    assert_eq!(bench.agent.holds(), ["tidy"]);
}

#[test]
fn a_refused_job_is_set_aside_only_by_who_knows_all_cells() {
    let cells = |labels: &[&str]| {
        let state = |label: &&str| CellState { labels: vec![label.to_string()], ..CellState::default() };
        labels.iter().zip(1..).map(|(label, n)| (format!("c{n}"), state(label), 1e9)).collect::<Vec<_>>()
    };
    let without_this = cells(&["a", "b"]).into_iter().skip(1).collect();
    for (listed, aside) in [
        (Some(cells(&["a"])), true),
        (Some(cells(&["a", "b"])), false),
        (Some(without_this), false),
        (Some(Vec::new()), false),
        (None, false),
    ] {
        let mut bench = Bench::ready();
        bench.pulled(&job("b"), 1);
        bench.read(None);
        let refused = Err("no such object".to_string());
        let effects = bench.take(Input::Judged { job: "tidy".into(), verdict: refused });
        assert!(effects.contains(&Effect::List), "{effects:?}");
        let effects = bench.take(Input::Cells(listed.clone()));
        let written = |effect: &Effect| matches!(effect, Effect::Write { claim, .. } if claim.state == ClaimState::Aside);
        let back = |effect: &Effect| matches!(effect, Effect::Settle(1, Settle::Back(_)));
        assert_eq!(effects.iter().any(written), aside, "{listed:?}: {effects:?}");
        assert_eq!(effects.iter().any(back), !aside, "{listed:?}: {effects:?}");
    }
}
