//! The place for a client at the gripper's Compute Box: there is one (Connectivity Guide).
//!
//! In: clients that come and go, simulated time. Out: whom the box serves. What it does with a second client
//! is not published, nor how long it keeps the place of one whose cable was pulled: [`BoxConfig`] has both.

use crate::box_clients::{BoxConfig, SecondClient};
use crate::gripper_server::Session;
use crate::robot_server::line::Line;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use ur_wire::bytes::WireError;

/// What the box does with a client now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Service {
    /// Its requests are answered.
    Served,
    /// Nothing of it is read yet.
    Waits,
    /// Its connection is ended.
    Ended,
}

/// The answers to a client's bytes, or that these are no Modbus TCP.
pub type CarriedOut = Result<Vec<u8>, WireError>;

/// A connection is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Over;

/// The box as all connections see it.
pub type SharedBox = Arc<Mutex<ComputeBox>>;

/// For a moment alone with it.
pub fn lock(compute_box: &SharedBox) -> MutexGuard<'_, ComputeBox> {
    compute_box.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The place. See the module.
#[derive(Debug, Default)]
pub struct ComputeBox {
    config: BoxConfig,
    /// Numbers of clients so far.
    last: u64,
    place: Option<Place>,
    /// Clients that wait, in their order.
    waiting: VecDeque<Place>,
}

/// Most bytes of a client that waits.
const UNREAD_MAX: usize = 64 * 1024;

#[derive(Debug)]
struct Place {
    number: u64,
    line: Line,
    session: Session,
    /// Sent before its turn.
    unread: Vec<u8>,
    /// Its client has gone, and the box does not know before this time, s.
    kept_until: Option<f64>,
}

impl ComputeBox {
    /// Nobody is connected.
    pub fn new(config: BoxConfig) -> ComputeBox {
        ComputeBox { config, ..ComputeBox::default() }
    }

    /// Takes in a client and returns its number. A client that gets or keeps no place is disconnected.
    pub fn enter(&mut self, now_s: f64, line: &Line) -> u64 {
        self.last += 1;
        self.free(now_s);
        let client = Place {
            number: self.last,
            line: line.clone(),
            session: Session::default(),
            unread: Vec::new(),
            kept_until: None,
        };
        match (&self.place, self.config.second) {
            (Some(_), SecondClient::Refused) => line.hang_up(),
            (Some(_), SecondClient::Waits) => self.waiting.push_back(client),
            (Some(first), SecondClient::Evicts) => {
                first.line.hang_up();
                self.place = Some(client);
            }
            (None, _) => self.place = Some(client),
        }
        self.last
    }

    /// A client's connection is gone; `unnoticed`: nothing of that has reached the box.
    pub fn leave(&mut self, now_s: f64, number: u64, unnoticed: bool) {
        let kept_s = if unnoticed { self.config.half_open_s } else { 0.0 };
        let all = self.place.iter_mut().chain(&mut self.waiting);
        for client in all.filter(|client| client.number == number) {
            client.kept_until = Some(now_s + kept_s);
        }
        self.free(now_s);
    }

    /// Bytes of a client: the answers, carried out by `carry_out`; none while it waits.
    ///
    /// # Errors
    /// The connection is over, or ends with this.
    pub fn receive(
        &mut self,
        now_s: f64,
        number: u64,
        bytes: &[u8],
        carry_out: impl FnOnce(&mut Session, &[u8]) -> CarriedOut,
    ) -> Result<Vec<u8>, Over> {
        let service = self.serves(now_s, number);
        let mut all = self.place.iter_mut().chain(&mut self.waiting);
        let client = all.find(|client| client.number == number).ok_or(Over)?;
        client.unread.extend_from_slice(bytes);
        match service {
            Service::Served => {
                let unread = std::mem::take(&mut client.unread);
                carry_out(&mut client.session, &unread).map_err(|_| Over)
            }
            Service::Waits if client.unread.len() <= UNREAD_MAX => Ok(Vec::new()),
            Service::Waits | Service::Ended => Err(Over),
        }
    }

    /// One controller frame: a client whose turn has come is answered what it sent before.
    pub fn frame(&mut self, now_s: f64, carry_out: impl FnOnce(&mut Session, &[u8]) -> CarriedOut) {
        self.free(now_s);
        let Some(place) = self.place.as_mut().filter(|place| !place.unread.is_empty()) else { return };
        let unread = std::mem::take(&mut place.unread);
        let sent = match carry_out(&mut place.session, &unread) {
            Ok(answers) => place.line.try_send(answers.into()),
            Err(_) => false,
        };
        if !sent {
            place.line.hang_up();
        }
    }

    /// How the box treats this client.
    pub fn serves(&mut self, now_s: f64, number: u64) -> Service {
        self.free(now_s);
        let is_it = |place: &Place| place.number == number && place.kept_until.is_none();
        if self.place.as_ref().is_some_and(is_it) {
            Service::Served
        } else if self.waiting.iter().any(is_it) {
            Service::Waits
        } else {
            Service::Ended
        }
    }

    /// The next client takes a place that is free. One that has gone meanwhile is served too, where it has
    /// sent anything: a socket gives out what came before the end.
    fn free(&mut self, now_s: f64) {
        let is_over = |place: &mut Place| {
            place.unread.is_empty() && place.kept_until.is_some_and(|until| now_s >= until)
        };
        loop {
            self.place.take_if(is_over);
            if self.place.is_some() {
                return;
            }
            self.place = self.waiting.pop_front();
            if self.place.is_none() {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines() -> [Line; 3] {
        [(); 3].map(|()| Line::open(None).0)
    }

    fn serves(compute_box: &mut ComputeBox, number: u64) -> bool {
        compute_box.serves(0.0, number) == Service::Served
    }

    #[test]
    fn a_second_client_is_refused_until_the_first_has_gone() {
        let mut compute_box = ComputeBox::new(BoxConfig::default());
        let [first, second, third] = lines();
        let one = compute_box.enter(0.0, &first);
        let two = compute_box.enter(1.0, &second);
        assert!(serves(&mut compute_box, one) && !serves(&mut compute_box, two));
        compute_box.leave(2.0, two, false);
        assert!(serves(&mut compute_box, one), "who was refused frees no place");
        compute_box.leave(3.0, one, false);
        let three = compute_box.enter(3.0, &third);
        assert!(serves(&mut compute_box, three));
    }

    #[test]
    fn a_second_client_evicts_the_first() {
        let config = BoxConfig { second: SecondClient::Evicts, half_open_s: 60.0 };
        let mut compute_box = ComputeBox::new(config);
        let [first, second, third] = lines();
        let one = compute_box.enter(0.0, &first);
        let two = compute_box.enter(1.0, &second);
        assert!(!serves(&mut compute_box, one) && serves(&mut compute_box, two));
        compute_box.leave(2.0, two, true);
        let three = compute_box.enter(3.0, &third);
        assert!(serves(&mut compute_box, three), "a half-open connection too");
    }

    #[test]
    fn the_place_of_a_client_whose_cable_was_pulled_is_kept_for_a_while() {
        let mut compute_box = ComputeBox::new(BoxConfig { half_open_s: 5.0, ..BoxConfig::default() });
        let [first, second, third] = lines();
        let one = compute_box.enter(0.0, &first);
        compute_box.leave(10.0, one, true);
        let two = compute_box.enter(14.9, &second);
        assert!(!serves(&mut compute_box, two));
        let three = compute_box.enter(15.0, &third);
        assert!(serves(&mut compute_box, three));
    }

    #[test]
    fn a_second_client_waits_until_its_turn_comes() {
        let config = BoxConfig { second: SecondClient::Waits, half_open_s: 5.0 };
        let mut compute_box = ComputeBox::new(config);
        let [first, second, third] = lines();
        let one = compute_box.enter(0.0, &first);
        let two = compute_box.enter(1.0, &second);
        let three = compute_box.enter(1.0, &third);
        assert_eq!(
            [one, two, three].map(|number| compute_box.serves(1.0, number)),
            [Service::Served, Service::Waits, Service::Waits]
        );
        compute_box.leave(2.0, two, false);
        compute_box.leave(2.0, one, true);
        assert_eq!(
            [one, two, three].map(|number| compute_box.serves(6.9, number)),
            [Service::Ended, Service::Ended, Service::Waits]
        );
        assert_eq!(compute_box.serves(7.0, three), Service::Served);
    }

    #[test]
    fn requests_of_who_waits_are_carried_out_in_its_turn_even_if_it_has_gone() {
        let config = BoxConfig { second: SecondClient::Waits, half_open_s: 5.0 };
        let mut compute_box = ComputeBox::new(config);
        let [first, second, _] = lines();
        let (third, mut inlet) = Line::open(None);
        let one = compute_box.enter(0.0, &first);
        let two = compute_box.enter(0.0, &second);
        let three = compute_box.enter(0.0, &third);
        let mut carried_out = Vec::new();
        for (number, request) in [(two, "second"), (three, "third")] {
            let refused = |_: &mut Session, _: &[u8]| panic!("not yet");
            assert_eq!(compute_box.receive(1.0, number, request.as_bytes(), refused), Ok(vec![]));
        }
        compute_box.leave(2.0, two, false);
        compute_box.leave(2.0, one, false);
        for frame in 0..3 {
            compute_box.frame(2.0 + f64::from(frame), |_, bytes| {
                carried_out.extend_from_slice(bytes);
                Ok(bytes.to_vec())
            });
        }
        assert_eq!(carried_out, b"secondthird");
        assert_eq!(inlet.take().as_deref(), Some(&b"third"[..]));
    }
}
