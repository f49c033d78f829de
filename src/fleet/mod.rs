//! The cell as part of a fleet: the daemon's end of [`cell_fleet`].
//!
//! `told`: what of the status goes to the fleet; `side`: the cell as its part in the fleet sees it; `start`:
//! the thread it runs on. Jobs go the way of job files, orders the way of the page's, and the state is the
//! status that is written for everyone: the loop knows nothing of a fleet, and is never kept waiting by one.

pub mod side;
pub mod start;
pub mod told;
