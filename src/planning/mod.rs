//! The rearrangement problem, its solvers, lower bound and independent plan checker.
