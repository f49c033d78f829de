//! How the gripper's Compute Box treats its clients.
//!
//! In: nothing. Out: plain data of the configuration. It serves one client at a time (Connectivity Guide);
//! the rest is not published.

/// What becomes of a second client.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SecondClient {
    /// Its connection is closed.
    #[default]
    Refused,
    /// It takes the place of the first.
    Evicts,
    /// It is connected, and its requests are carried out once the first has gone.
    Waits,
}

/// How the box treats its clients.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BoxConfig {
    /// What becomes of a second client.
    pub second: SecondClient,
    /// How long it keeps the place of a client whose end it has not noticed, s.
    pub half_open_s: f64,
}
