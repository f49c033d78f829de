//! Benchmark runners, their tables and figures.
//!
//! `table`: rows and their CSV. `planning`: one case. `cells`: which cases a run consists of, and its share
//! of them. `baseline`: beside the public code's own figures. `runner`: many cases on many threads.
//! `results`: the file that survives interruptions. `summary`: a table for people. `figures`: the paper's
//! six figures from rows. `motion`: kinematics, the check of paths, ways; `cycle`: where the time of a
//! pick-n-place goes, `blends`: what safe corners cost of it. `rtde`: the codec and the simulator's own
//! timing, with `rtde_client` as the clients and `rtde_process` as the simulator that is watched.
//! `closed_loop`: speed and promises of the whole cell in virtual time. `vision`: rate, accuracy and time
//! of detection and poses.

pub mod baseline;
pub mod blends;
pub mod cells;
pub mod closed_loop;
pub mod cycle;
pub mod figures;
pub mod motion;
pub mod motion_model;
pub mod planning;
pub mod results;
pub mod rtde;
pub mod rtde_client;
mod rtde_process;
pub mod runner;
pub mod script;
pub mod summary;
pub mod table;
pub mod targets;
pub mod vision;
