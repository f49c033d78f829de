//! What the loop receives from sockets, workers and the state folder.
//!
//! Plain data, below all of them, so that none of them has to know the loop.

use cell_calibration::fit::Sample;
use cell_edge::clock::boot_now_s;
use cell_machine::device::robot_types::Link;
use cell_machine::event::Event;
use cell_machine::intake::Origin;
use cell_machine::orders::Order;
use cell_values::image::Image;
use cell_vision::observe::{Observation, View};
use std::sync::Arc;
use tokio::net::TcpStream;

/// Whether the client that gave an order still waits for its answer.
pub type ClientWaits = Arc<dyn Fn() -> bool + Send + Sync>;

/// An order that was given.
#[derive(Clone)]
pub struct Given {
    /// Of its source: from 1, without repetition.
    pub number: u32,
    /// What is ordered.
    pub order: Order,
    /// When it was given, s since the machine started. May come from outside: any number or none.
    pub boot_s: f64,
    /// Judged when the order is decided.
    pub client_waits: ClientWaits,
}

impl Given {
    /// The order's origin, as it is now.
    pub fn origin(&self) -> Origin {
        Origin { age_s: boot_now_s() - self.boot_s, client_waits: (self.client_waits)() }
    }
}

/// Something for the loop.
pub enum Message {
    /// For the machine.
    Event(Event),
    /// An operator's order and its number; its origin is judged when it is handed over.
    Order(u64, Given),
    /// A connection was made, or could not be.
    Made(Made),
    /// To be shown or recorded.
    Displayed(Displayed),
}

/// What a worker has to show.
#[derive(Debug)]
pub enum Displayed {
    /// The last frame of a look pose.
    Picture {
        /// What it shows.
        image: Image,
        /// Camera pose and markers.
        views: Vec<View>,
    },
    /// The table as measured.
    Observed {
        /// What was seen.
        seen: Box<Observation>,
        /// Only a part of the table was looked at.
        partial: bool,
    },
    /// A picture of a calibration round.
    Sample {
        /// The pose's number, from 1.
        pose: usize,
        /// The picture taken there.
        image: Image,
        /// Where the flange was and which markers were found.
        sample: Sample,
    },
}

/// A connection that was made, or why not.
pub struct Made {
    /// To what.
    pub link: Link,
    /// Which attempt; what an earlier one leads to is dropped.
    pub attempt: u64,
    /// The connection.
    pub result: std::io::Result<TcpStream>,
}
