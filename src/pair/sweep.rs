//! Every fault in every phase.
