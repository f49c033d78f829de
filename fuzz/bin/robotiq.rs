//! Fuzz target `robotiq`; what it does is in `targets.rs`.
#![no_main]

#[allow(dead_code, reason = "each binary runs one of the targets")]
#[path = "../targets.rs"]
mod targets;

libfuzzer_sys::fuzz_target!(|data: &[u8]| targets::robotiq(data));
