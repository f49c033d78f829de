//! The page: what the operator sees and sets, and the same as an API.
//!
//! `app`: how the daemon puts it together; `shared`: what all handlers share. `feed`: what happens, for
//! those who watch; `views`: how it is shown. `access`: who may do what; `control`: who has the cell in
//! hand; `limits` and `guard`: what comes before any handler; `routes`: the table of addresses; `session`,
//! `live`, `work`, `markers`, `metrics`: what answers there; `drafts`: goals set by hand; `orders`: on
//! their way to the machine; `openapi`: the API in a document; `server`: connections; `assets`: the
//! browser's part, plain scripts without a build step.
//!
//! It decides nothing about the cell: orders go the way of command files, jobs the way of job files, and
//! what it shows is what the daemon writes for everyone.

pub mod access;
pub mod app;
mod assets;
pub mod control;
pub mod drafts;
pub mod feed;
mod guard;
mod limits;
mod live;
mod markers;
mod metrics;
pub mod openapi;
pub mod orders;
pub mod routes;
mod server;
mod session;
pub mod shared;
pub mod views;
mod work;

pub use server::ServeError;
