//! Images, marker detection, object poses with their uncertainty, calibration mathematics.
