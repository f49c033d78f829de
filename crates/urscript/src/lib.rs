//! URScript: the language of the robot's controller, from text to running threads.
//!
//! In: the text of a program and a [`host::Host`] that knows the built-ins which touch the robot. Out: a
//! [`program::Program`] that is advanced one controller frame (2 ms) at a time, and faults with line and
//! column. Pure: no clock, socket or file; time is the number of frames, randomness comes from a seed.
//!
//! Path: [`lexer`] (text to tokens) -> [`parser`] (tokens to [`ast`]) -> [`compile`] (AST to [`code`]) ->
//! [`program`] and [`thread`] (the scheduler and its threads) with [`value`], [`operators`] and [`library`]
//! underneath. Compiling to instructions instead of walking the tree is what lets a thread stop anywhere
//! (a blocking built-in, a used-up slice, a kill) without a machine thread of its own.
//! Source: UR's script manual as condensed in the interface notes; where the language is undocumented the
//! choice is stated at the function that makes it.

pub mod ast;

mod body;

mod bounds;

pub mod code;

pub mod compile;

pub mod extend;

pub mod fault;

pub mod host;

pub mod lexer;

pub mod library;

pub mod list_library;

pub mod methods;

pub mod operators;

pub mod parser;

pub mod pose_library;

pub mod program;

pub mod scope;

pub mod statement;

pub mod string_library;

pub mod thread;

pub mod value;

/// The example of the README, run by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
