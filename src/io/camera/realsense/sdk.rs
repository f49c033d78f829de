//! The C interface of librealsense2, loaded at run time: one binary works with and without the SDK.
//!
//! In: where the library is, or nothing. Out: handles that free themselves, and results instead of error
//! pointers. Every call that can fail hands the SDK a place for its error and looks at it before anything
//! else; every pointer that comes back is checked; sizes that the SDK reports are compared with what the
//! picture needs before a byte is read. All unsafe code for the camera is in the files below this one:
//! `library` (its functions and how they are called), `profiles` (what a stream is), `devices` (what is
//! connected, its settings) and `streams` (what it sends). The declarations follow the headers of SDK 2.59;
//! functions that were there in 2.51 already are used alone.

#![allow(unsafe_code, reason = "a C interface; what makes each call sound is said where it is made")]

mod devices;
mod library;
mod profiles;
mod streams;

pub use devices::{Context, Device, Sensor};
pub use library::{
    FORMAT_RGB8, FORMAT_Z16, INFO_NAME, INFO_SERIAL, Intrinsics, OLDEST, OPTION_AUTO_EXPOSURE,
    OPTION_EXPOSURE, STREAM_COLOUR, STREAM_DEPTH, Sdk, SdkError, Version,
};
pub use profiles::Stream;
pub use streams::{Align, Config, Frames, Picture, Pipeline, Profile};
