//! What the loop receives from sockets, workers and the state folder.
//!
//! Plain data, below all of them, so that none of them has to know the loop.

use crate::jobs::sources::Given;
use cell_calibration::fit::Sample;
use cell_machine::device::robot_types::Link;
use cell_machine::event::Event;
use cell_values::image::Image;
use cell_vision::observe::{Observation, View};
use tokio::net::TcpStream;

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

/// The device at the other end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Peer {
    /// The controller.
    Controller(Link),
    /// The gripper's box.
    Gripper,
}

/// A connection that was made, or why not.
pub struct Made {
    /// To what.
    pub to: Peer,
    /// Which attempt; what an earlier one leads to is dropped.
    pub attempt: u64,
    /// The connection.
    pub result: std::io::Result<TcpStream>,
}
