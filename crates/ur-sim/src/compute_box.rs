//! The place for a client at the gripper's Compute Box: there is one (Connectivity Guide).
//!
//! In: clients that come and go, simulated time. Out: whom the box serves. What it does with a second client
//! is not published, nor how long it keeps the place of one whose cable was pulled: [`BoxConfig`] has both.

use crate::robot_server::line::Line;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// What becomes of a second client.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SecondClient {
    /// Its connection is closed.
    #[default]
    Refused,
    /// It takes the place of the first.
    Evicts,
    /// It is connected, and nothing of it is read before the first has gone: what it sent by then is carried
    /// out with what it sends next.
    Waits,
}

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

/// How the box treats its clients.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BoxConfig {
    /// What becomes of a second client.
    pub second: SecondClient,
    /// How long it keeps the place of a client whose end it has not noticed, s.
    pub half_open_s: f64,
}

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

#[derive(Debug)]
struct Place {
    number: u64,
    line: Line,
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
        let client = Place { number: self.last, line: line.clone(), kept_until: None };
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
        self.waiting.retain(|client| client.number != number);
        if let Some(place) = self.place.as_mut().filter(|place| place.number == number) {
            let kept_s = if unnoticed { self.config.half_open_s } else { 0.0 };
            place.kept_until = Some(now_s + kept_s);
            self.free(now_s);
        }
    }

    /// How the box treats this client.
    pub fn serves(&mut self, now_s: f64, number: u64) -> Service {
        self.free(now_s);
        if self.place.as_ref().is_some_and(|place| place.number == number) {
            Service::Served
        } else if self.waiting.iter().any(|client| client.number == number) {
            Service::Waits
        } else {
            Service::Ended
        }
    }

    fn free(&mut self, now_s: f64) {
        self.place.take_if(|place| place.kept_until.is_some_and(|until| now_s >= until));
        if self.place.is_none() {
            self.place = self.waiting.pop_front();
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
            [Service::Served, Service::Ended, Service::Waits]
        );
        assert_eq!(compute_box.serves(7.0, three), Service::Served);
    }
}
