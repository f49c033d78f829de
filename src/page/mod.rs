//! The page: what the operator sees and sets, and the same as an API.
//!
//! `app`: how the daemon puts it together; `shared`: what all handlers share. `feed`: what happens, for
//! those who watch; `views`: how it is shown; `turns`: how evenly the loop turns. `access`: who may do
//! what; `control`: who has the cell in hand; `limits` and `guard`: what comes before any handler;
//! `routes`: the table of addresses; `session`, `live`, `work`, `again`, `shift`, `records`, `markers`,
//! `metrics`: what answers there; `film` with `screen`: the camera's pictures as they come;
//! `calibration`: guided steps; `drafts`: goals set by hand; `orders`: on their way to the machine;
//! `openapi`: the API in a document; `server` with `places` and `connections`: who is connected, and who
//! is cut; `assets`: the browser's part, plain scripts
//! without a build step; `texts`: other languages.
//!
//! It decides nothing about the cell: orders go where those of command files go, jobs the way of job files,
//! and what it shows is what the daemon writes for everyone.

pub mod access;
mod again;
pub mod app;
pub(crate) mod assets;
pub mod calibration;
pub(crate) mod connections;
pub mod control;
pub mod drafts;
pub mod feed;
mod film;
pub(crate) mod guard;
pub(crate) mod limits;
mod live;
mod markers;
mod metrics;
pub mod openapi;
pub mod orders;
pub(crate) mod places;
mod records;
pub mod routes;
pub mod screen;
pub(crate) mod server;
mod session;
pub mod shared;
mod shift;
pub mod texts;
pub mod turns;
pub mod views;
mod work;

pub use server::ServeError;
