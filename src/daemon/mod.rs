//! The tokio shell that drives the supervisor, devices, cameras and workers.
