//! When a connection to the controller is made, and made anew.
//!
//! In: that a connection was made or lost, the time. Out: orders to connect and to close. Reconnecting backs
//! off from 100 ms to 2 s, because a cell that came back must not wait a minute for its daemon (reference:
//! ecosystem, 0.3); a request that is not answered within 2 s is given up. Pure, so that a test decides when
//! a link comes back.

use crate::device::outbox::earlier;
use crate::device::robot_types::Link;
use cell_values::time::{Duration, Timestamp};
use serde::{Deserialize, Serialize};

/// First and longest pause between two attempts to connect.
const BACKOFF: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(2));

/// How long a request to connect may take.
const CONNECT_WITHIN: Duration = Duration::from_secs(2);

/// What is to be done with a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wish {
    /// Make it.
    Connect(Link),
    /// Drop it, or the attempt to make it.
    Close(Link),
}

#[derive(Debug, Deserialize, Serialize)]
enum State {
    Down { retry_at: Timestamp },
    Requested { deadline: Timestamp },
    Up,
}

#[derive(Debug, Deserialize, Serialize)]
struct Connection {
    link: Link,
    state: State,
    pause: Duration,
    /// Why it is down.
    reason: Option<String>,
    /// It is down because celld has dropped it, to make it anew.
    dropped: bool,
}

/// The three connections to the controller.
#[derive(Debug, Deserialize, Serialize)]
pub struct Connections([Connection; 3]);

impl Default for Connections {
    fn default() -> Connections {
        Connections(Link::ALL.map(|link| Connection {
            link,
            state: State::Down { retry_at: Timestamp::ZERO },
            pause: BACKOFF.0,
            reason: None,
            dropped: false,
        }))
    }
}

impl Connections {
    fn of(&mut self, link: Link) -> &mut Connection {
        let [rtde, dashboard, primary] = &mut self.0;
        match link {
            Link::Rtde => rtde,
            Link::Dashboard => dashboard,
            Link::Primary => primary,
        }
    }

    /// The connection was made.
    pub fn made(&mut self, link: Link) {
        let connection = self.of(link);
        connection.state = State::Up;
        connection.pause = BACKOFF.0;
        connection.reason = None;
        connection.dropped = false;
    }

    /// It is gone, or could not be made.
    pub fn lost(&mut self, now: Timestamp, link: Link, reason: String) {
        let connection = self.of(link);
        connection.state = State::Down { retry_at: now + connection.pause };
        connection.pause = (connection.pause * 2).min(BACKOFF.1);
        connection.reason = Some(reason);
        connection.dropped = false;
    }

    /// celld drops it, to make it anew.
    pub fn dropped(&mut self, now: Timestamp, link: Link) {
        self.lost(now, link, "dropped by celld".to_string());
        self.of(link).dropped = true;
    }

    /// True while it is down and celld has not dropped it by itself.
    pub fn is_lost(&self, link: Link) -> bool {
        !self.is_up(link) && !self.0.iter().any(|connection| connection.link == link && connection.dropped)
    }

    /// True while bytes can be sent.
    pub fn is_up(&self, link: Link) -> bool {
        self.0.iter().any(|connection| connection.link == link && matches!(connection.state, State::Up))
    }

    /// What is due now.
    pub fn tick(&mut self, now: Timestamp) -> Option<Wish> {
        for connection in &mut self.0 {
            match connection.state {
                State::Down { retry_at } if now >= retry_at => {
                    connection.state = State::Requested { deadline: now + CONNECT_WITHIN };
                    return Some(Wish::Connect(connection.link));
                }
                State::Requested { deadline } if now >= deadline => {
                    let link = connection.link;
                    self.lost(now, link, "no answer to the connection request".to_string());
                    return Some(Wish::Close(link));
                }
                State::Down { .. } | State::Requested { .. } | State::Up => {}
            }
        }
        None
    }

    /// When [`Connections::tick`] has something to do next.
    pub fn next_wake(&self) -> Option<Timestamp> {
        let due = self.0.iter().map(|connection| match connection.state {
            State::Down { retry_at } => Some((retry_at, ())),
            State::Requested { deadline } => Some((deadline, ())),
            State::Up => None,
        });
        due.fold(None, earlier).map(|(at, ())| at)
    }

    /// Why links are down, one line each; empty when all are up.
    pub fn why_down(&self) -> Vec<String> {
        let down = self.0.iter().filter_map(|c| c.reason.as_ref().map(|reason| (c.link, reason)));
        down.map(|(link, reason)| format!("{link}: {reason}")).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Timestamp {
        Timestamp::from_nanos(ms * 1_000_000)
    }

    #[test]
    fn attempts_back_off_and_start_anew_after_a_success() {
        let mut connections = Connections::default();
        for link in Link::ALL {
            assert_eq!(connections.tick(at(0)), Some(Wish::Connect(link)));
        }
        assert_eq!(connections.tick(at(0)), None);
        connections.made(Link::Dashboard);
        connections.made(Link::Primary);
        let mut now = 0;
        for pause in [100, 200, 400, 800, 1600, 2000, 2000] {
            connections.lost(at(now), Link::Rtde, "refused".into());
            assert_eq!(connections.tick(at(now + pause - 1)), None, "{pause}");
            now += pause;
            assert_eq!(connections.next_wake(), Some(at(now)));
            assert_eq!(connections.tick(at(now)), Some(Wish::Connect(Link::Rtde)));
        }
        assert_eq!(connections.why_down(), ["RTDE: refused"]);
        connections.made(Link::Rtde);
        assert!(connections.is_up(Link::Rtde) && connections.why_down().is_empty());
        connections.lost(at(now), Link::Rtde, "reset".into());
        assert_eq!(connections.next_wake(), Some(at(now + 100)));
    }

    #[test]
    fn a_request_without_an_answer_is_given_up() {
        let mut connections = Connections::default();
        while connections.tick(at(5)).is_some() {}
        assert_eq!(connections.tick(at(2004)), None);
        assert_eq!(connections.tick(at(2005)), Some(Wish::Close(Link::Rtde)));
        assert!(!connections.is_up(Link::Rtde));
        assert_eq!(connections.why_down(), ["RTDE: no answer to the connection request"]);
    }
}
