//! Calibration at the page: guided steps with live detection, residuals and pictures.
//!
//! `bench`: what lies on the bench (pictures of a board, a round's samples, touches, a solution that is not
//! kept yet). `lens`, `round`, `touch`: the three kinds of work; `kept`: files written. `found`: what the
//! film shows now; `steps`: the addresses. What is computed is `cell_calibration`, as for `celld calibrate`.
//!
//! Nothing here moves the arm. A round is an order to the machine like any other (`Order::Calibrate`), with
//! its gates; its pictures arrive here. What is kept counts from celld's next start: the cell that runs goes
//! on with the numbers that it was started with.

pub mod bench;
pub mod found;
mod kept;
mod lens;
mod round;
pub mod steps;
mod touch;
