//! The cell as part of a fleet: the daemon's end of [`cell_fleet`].
//!
//! `reported`: what of the status goes to the fleet; `side`: the cell as its part in the fleet sees it;
//! `files`: a job's files on request; `fragment`: the shared part of the configuration; `start`: the thread
//! it runs on. Jobs go the way of job files, orders the way of the page's, and the state is the status that
//! is written for everyone: the loop knows nothing of a fleet, and is never kept waiting by one.
//!
//! `view`: the fleet as people look at it, with `words`; `watch`: followed; `page`: the page of all cells;
//! `demo`: a whole fleet on one computer.

pub mod demo;
pub mod ends;
pub mod files;
pub mod fragment;
pub mod page;
pub mod reported;
pub mod side;
pub mod start;
pub mod view;
pub mod watch;
pub mod words;
