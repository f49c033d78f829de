//! Time of a move that speeds up, cruises and brakes.
//!
//! In: length, speed and acceleration in one unit. Out: seconds. Pure.

/// Seconds of a move from rest to rest.
pub fn rest_to_rest(length: f64, speed: f64, acceleration: f64) -> f64 {
    if length < speed * speed / acceleration {
        2.0 * (length / acceleration).sqrt()
    } else {
        length / speed + speed / acceleration
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_move_takes_the_time_of_its_trapezoid() {
        assert!((rest_to_rest(1.0, 0.5, 1.0) - 2.5).abs() < 1e-12);
        assert!((rest_to_rest(0.16, 0.5, 1.0) - 0.8).abs() < 1e-12);
    }
}
