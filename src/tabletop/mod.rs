//! Object catalogue, workspace, arrangement, instance files and importers.
