//! Places for connections and streams: which connection is cut for a new one, and what is refused.
//!
//! In: connections that arrive and what each one does, by the time. Out: a place, with the connection that
//! is cut for it, or a refusal. Connections that do least lose their places first: idle ones, then those
//! without a session, slow bodies, unread answers, last a request of the session with most requests at a
//! time. A few connections may wait for the head of a request while others are cut, so a stop finds a place
//! whatever other sessions send. Streams have places of their own, fewer than all. Pure.

use std::collections::HashMap;
use std::net::IpAddr;
use std::time::{Duration, Instant};

/// Connections at a time: a browser opens six.
const CONNECTIONS: usize = 200;

/// Connections of one computer, in percent of all.
const OF_ONE_PERCENT: usize = 60;

/// Requests of one session that are served at a time, in percent of all connections.
const OF_SESSION_PERCENT: usize = 20;

/// So many connections, in percent of all, are not cut for new ones before they have sent a request.
const AWAITED_PERCENT: usize = 10;

/// Streams of events at a time: percent of all connections, and streams of one session.
pub const EVENT_STREAMS: (usize, usize) = (30, 24);

/// The same of the film.
pub const FILM_STREAMS: (usize, usize) = (15, 12);

/// An answer that its reader does not take within this time gives its place up for a new connection.
const READ_WITHIN: Duration = Duration::from_secs(2);

/// Idle connections are cut last if there are only a few.
const LAST_RANK: u8 = 6;

/// How many connections a process with so many file handles has: the other half is for the cell.
pub fn most_connections(handles: usize) -> usize {
    CONNECTIONS.min(handles / 2)
}

/// What a connection does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Doing {
    /// It waits for the head of a request.
    AwaitsHead,
    /// The head of a request is there, its body may not be.
    AwaitsBody,
    /// A request is carried out.
    Serves,
    /// The answer is sent.
    Answers,
    /// The answer is a stream, which has a place of its own.
    Streams,
}

/// A connection that has a place.
#[derive(Debug)]
struct Held {
    id: u64,
    computer: IpAddr,
    doing: Doing,
    since: Instant,
    /// The session of its last request.
    session: Option<String>,
}

/// What decides which of some connections is cut.
struct Competition<'a> {
    /// The session with most requests at a time, if it has more than one.
    busiest: Option<&'a str>,
    /// More connections wait for the head of a request than are kept for that.
    many_idle: bool,
    now: Instant,
}

impl Held {
    /// The lowest is cut first; `None` is not cut.
    fn rank(&self, among: &Competition) -> Option<u8> {
        match (self.doing, self.session.as_deref()) {
            (Doing::AwaitsHead, session) => {
                Some(u8::from(session.is_some()) + if among.many_idle { 0 } else { LAST_RANK })
            }
            (Doing::AwaitsBody | Doing::Serves | Doing::Answers, None) => Some(2),
            (Doing::AwaitsBody, Some(_)) => Some(3),
            (Doing::Answers, Some(_)) if among.now.duration_since(self.since) >= READ_WITHIN => Some(4),
            // A stop whose connection is cut still counts; any other order is withdrawn.
            (Doing::Serves | Doing::Answers, session) if session == among.busiest => Some(5),
            (Doing::Serves | Doing::Answers, Some(_)) | (Doing::Streams, _) => None,
        }
    }

    /// It has a request that is not answered yet.
    fn at_work(&self) -> bool {
        matches!(self.doing, Doing::AwaitsBody | Doing::Serves | Doing::Answers)
    }
}

/// What comes of a connection that arrives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// It has a place; another connection is cut where there was none left.
    Taken {
        /// Its number.
        id: u64,
        /// The one that is cut.
        cut: Option<u64>,
    },
    /// All places serve requests of sessions that have one each, or streams.
    Refused,
}

/// All connections.
#[derive(Debug, Default)]
pub struct Table {
    held: Vec<Held>,
    last: u64,
}

impl Table {
    /// A connection arrives; `most`: how many there may be now.
    pub fn arrive(&mut self, computer: IpAddr, most: usize, now: Instant) -> Arrival {
        let of_one = self.held.iter().filter(|held| held.computer == computer).count();
        let cut = if of_one >= (most * OF_ONE_PERCENT / 100).max(1) {
            self.cut(most, now, |held| held.computer == computer)
        } else if self.held.len() >= most {
            self.cut(most, now, |_| true)
        } else {
            return Arrival::Taken { id: self.enter(computer, now), cut: None };
        };
        match cut {
            Some(_) => Arrival::Taken { id: self.enter(computer, now), cut },
            None => Arrival::Refused,
        }
    }

    fn enter(&mut self, computer: IpAddr, now: Instant) -> u64 {
        self.last += 1;
        let doing = Doing::AwaitsHead;
        self.held.push(Held { id: self.last, computer, doing, since: now, session: None });
        self.last
    }

    /// Takes the place of the connection that is missed least, of those wanted.
    fn cut(&mut self, most: usize, now: Instant, wanted: impl Fn(&Held) -> bool) -> Option<u64> {
        let wanted: Vec<(usize, &Held)> =
            self.held.iter().enumerate().filter(|(_, held)| wanted(held)).collect();
        let idle = wanted.iter().filter(|(_, held)| held.doing == Doing::AwaitsHead).count();
        let busiest = busiest(wanted.iter().map(|(_, held)| *held));
        let many_idle = idle > (most * AWAITED_PERCENT / 100).max(1);
        let among = Competition { busiest, many_idle, now };
        let ranked = wanted.iter().filter_map(|(index, held)| Some((held.rank(&among)?, held.since, *index)));
        let (_, _, index) = ranked.min()?;
        Some(self.held.remove(index).id)
    }

    /// Takes the place of any connection that may be cut: the process is out of handles.
    pub fn cut_one(&mut self, most: usize, now: Instant) -> Option<u64> {
        self.cut(most, now, |_| true)
    }

    /// A connection does something else now. With a new request its session is not known yet.
    pub fn turns_to(&mut self, id: u64, doing: Doing, now: Instant) {
        if let Some(held) = self.held.iter_mut().find(|held| held.id == id) {
            (held.doing, held.since) = (doing, now);
            if doing == Doing::AwaitsBody {
                held.session = None;
            }
        }
    }

    /// The request on this connection belongs to a session; false if the session has too many at a time.
    pub fn signed_in(&mut self, id: u64, session: &str, most: usize) -> bool {
        if let Some(held) = self.held.iter_mut().find(|held| held.id == id) {
            held.session = Some(session.to_string());
        }
        let of_session = |held: &&Held| held.at_work() && held.session.as_deref() == Some(session);
        let served = self.held.iter().filter(of_session).count();
        served <= (most * OF_SESSION_PERCENT / 100).max(1)
    }

    /// A connection has ended.
    pub fn leave(&mut self, id: u64) {
        self.held.retain(|held| held.id != id);
    }
}

/// The session with most requests that are not answered yet, if it has more than one.
fn busiest<'a>(held: impl Iterator<Item = &'a Held>) -> Option<&'a str> {
    let mut requests = HashMap::new();
    for session in held.filter(|held| held.at_work()).filter_map(|held| held.session.as_deref()) {
        *requests.entry(session).or_insert(0) += 1;
    }
    let several = requests.into_iter().filter(|(_, count)| *count > 1);
    several.max_by_key(|(session, count)| (*count, *session)).map(|(session, _)| session)
}

/// Places for one kind of stream.
#[derive(Debug)]
pub struct Streams {
    /// Of all connections, percent.
    percent: usize,
    of_session: usize,
    open: HashMap<String, usize>,
}

impl Streams {
    /// At most so many percent of all connections, and so many of one session.
    pub fn new(percent: usize, of_session: usize) -> Streams {
        Streams { percent, of_session, open: HashMap::new() }
    }

    /// A stream of a session is opened; `most`: how many connections there may be now.
    ///
    /// # Errors
    /// The sentence with which it is refused.
    pub fn open(&mut self, session: &str, most: usize) -> Result<(), String> {
        let all = most * self.percent / 100;
        if self.open.values().sum::<usize>() >= all {
            return Err(format!("too many viewers: {all} streams of this kind are open; close one"));
        }
        let of_session = self.open.get(session).copied().unwrap_or(0);
        if of_session >= self.of_session {
            return Err(format!(
                "too many viewers: this session has {of_session} streams of this kind open; close one"
            ));
        }
        self.open.insert(session.to_string(), of_session + 1);
        Ok(())
    }

    /// A stream of a session has ended.
    pub fn close(&mut self, session: &str) {
        if let Some(open) = self.open.get_mut(session) {
            *open -= 1;
            if *open == 0 {
                self.open.remove(session);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOST: usize = 10;

    fn computer(last: u8) -> IpAddr {
        IpAddr::from([127, 0, 1, last])
    }

    /// A full table: each connection from a computer of its own, with a number from 1 to `MOST`.
    fn full(start: Instant) -> Table {
        let mut table = Table::default();
        for last in 1..=MOST as u8 {
            let at = start + Duration::from_millis(last.into());
            let taken = Arrival::Taken { id: last.into(), cut: None };
            assert_eq!(table.arrive(computer(last), MOST, at), taken);
        }
        table
    }

    /// This connection has a request of this session, and is so far with it.
    fn works(table: &mut Table, id: u64, session: Option<&str>, doing: Doing, now: Instant) {
        table.turns_to(id, Doing::AwaitsBody, now);
        if let Some(session) = session {
            table.signed_in(id, session, MOST);
        }
        table.turns_to(id, doing, now);
    }

    /// Which connection is cut for a new one, which then serves a session of its own.
    fn cut(table: &mut Table, last: u8, now: Instant) -> Option<u64> {
        match table.arrive(computer(last), MOST, now) {
            Arrival::Taken { id, cut } => {
                works(table, id, Some(&format!("new {id}")), Doing::Serves, now);
                cut
            }
            Arrival::Refused => None,
        }
    }

    #[test]
    fn strangers_are_cut_before_idle_sessions_and_a_session_with_one_request_never() {
        let start = Instant::now();
        let mut table = full(start);
        for (id, doing, session) in [
            (1, Doing::Serves, Some("anna")),
            (2, Doing::Streams, Some("anna")),
            (3, Doing::AwaitsHead, Some("anna")),
            (4, Doing::Answers, None),
            (5, Doing::Serves, None),
            (6, Doing::Answers, Some("ben")),
            (7, Doing::AwaitsBody, Some("eve")),
        ] {
            works(&mut table, id, session, doing, start + Duration::from_millis(100 + id));
        }
        let soon = start + Duration::from_secs(1);
        // Each computer has its own limit.
        let order: Vec<_> = (0..7).map(|last| cut(&mut table, 200 + last, soon)).collect();
        assert_eq!(order, [8, 9, 10, 4, 5, 7, 3].map(Some), "one connection may wait for its request");
        assert_eq!(cut(&mut table, 208, soon), None, "an answer on its way stays");
        assert_eq!(cut(&mut table, 208, start + Duration::from_millis(106) + READ_WITHIN), Some(6));
    }

    #[test]
    fn a_session_with_many_requests_gives_its_oldest_up_for_another_session() {
        let start = Instant::now();
        let mut table = full(start);
        for id in 1..=MOST as u64 {
            let session = if id % 3 == 0 { "anna" } else { "eve" };
            works(&mut table, id, Some(session), Doing::Serves, start + Duration::from_millis(100 - id));
        }
        let order: Vec<_> = (0..4).map(|last| cut(&mut table, 200 + last, start + READ_WITHIN)).collect();
        assert_eq!(order, [10, 8, 7, 5].map(Some), "of eve, who has most, until she has as many as anna");
        let left: Vec<_> = (0..5).map(|last| cut(&mut table, 210 + last, start + READ_WITHIN)).collect();
        assert_eq!(left, [Some(4), Some(9), Some(2), Some(6), None], "each keeps one");
    }

    /// One session holds every place, and each connection that is cut comes again at once.
    #[test]
    fn a_new_connection_keeps_its_place_until_its_request_is_there() {
        let start = Instant::now();
        let mut table = full(start);
        for id in 1..=MOST as u64 {
            let doing = if id % 2 == 0 { Doing::Serves } else { Doing::AwaitsBody };
            works(&mut table, id, Some("eve"), doing, start + Duration::from_millis(100 + id));
        }
        let Arrival::Taken { id: anna, .. } = table.arrive(computer(200), MOST, start + READ_WITHIN) else {
            panic!("a place");
        };
        for last in 0..8 {
            let Arrival::Taken { id, cut } = table.arrive(computer(201 + last), MOST, start + READ_WITHIN)
            else {
                panic!("a place");
            };
            assert_ne!(cut, Some(anna));
            works(&mut table, id, Some("eve"), Doing::AwaitsBody, start + READ_WITHIN);
        }
    }

    #[test]
    fn one_computer_makes_room_among_its_own_connections() {
        let now = Instant::now();
        let mut table = Table::default();
        assert_eq!(table.arrive(computer(1), MOST, now), Arrival::Taken { id: 1, cut: None });
        for id in 2..=7 {
            assert_eq!(table.arrive(computer(2), MOST, now), Arrival::Taken { id, cut: None });
        }
        assert_eq!(table.arrive(computer(2), MOST, now), Arrival::Taken { id: 8, cut: Some(2) });
        table.leave(3);
        assert_eq!(table.arrive(computer(2), MOST, now), Arrival::Taken { id: 9, cut: None });
    }

    #[test]
    fn out_of_handles_one_connection_is_cut() {
        let now = Instant::now();
        let mut table = full(now);
        assert_eq!(table.cut_one(MOST, now), Some(1));
        assert_eq!(Table::default().cut_one(MOST, now), None);
    }

    #[test]
    fn one_session_is_served_a_bounded_number_of_requests_at_a_time() {
        let now = Instant::now();
        let mut table = full(now);
        for id in 1..=3 {
            table.turns_to(id, Doing::AwaitsBody, now);
            assert_eq!(table.signed_in(id, "anna", MOST), id <= 2, "{id}");
        }
        table.turns_to(4, Doing::AwaitsBody, now);
        assert!(table.signed_in(4, "ben", MOST));
    }

    #[test]
    fn connections_take_at_most_half_of_the_handles_and_streams_at_most_half_of_the_connections() {
        assert_eq!([1 << 20, 1024, 256, 2].map(most_connections), [200, 200, 128, 1]);
        let mut streams = Streams::new(30, 2);
        assert_eq!((streams.open("anna", MOST), streams.open("anna", MOST)), (Ok(()), Ok(())));
        assert!(streams.open("anna", MOST).unwrap_err().contains("this session has 2"));
        assert_eq!(streams.open("ben", MOST), Ok(()));
        assert!(streams.open("eve", MOST).unwrap_err().contains("3 streams of this kind"));
        streams.close("anna");
        assert_eq!(streams.open("eve", MOST), Ok(()));
    }
}
