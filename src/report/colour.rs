//! One colour an object, in every picture: from its place in the catalogue or instance.
//!
//! In: an index, and for what. Out: a CSS colour. Hues lie a golden angle apart, so that neighbours differ;
//! after twelve objects the lightness changes too. Labels say what colours alone do not. Pure.

/// Distinct on light and dark ground, for outlines and fills.
pub fn of(index: usize) -> String {
    let lightness = [46, 54, 40][index / 12 % 3];
    shade(index, lightness)
}

/// The same hue at another lightness, %.
pub fn shade(index: usize, lightness: u32) -> String {
    let hue = (210.0 + 137.508 * index as f64) % 360.0;
    format!("hsl({hue:.0},58%,{lightness}%)")
}

/// What never moves.
pub const FIXED: &str = "#b5b5b5";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_differ_and_shades_are_of_one_hue() {
        let hue = |colour: String| colour.split(',').next().unwrap_or_default().to_string();
        for index in 0..40 {
            assert_ne!(of(index), of(index + 1));
            assert_eq!(hue(of(index)), hue(shade(index, 80)));
        }
        let first: std::collections::BTreeSet<_> = (0..36).map(of).collect();
        assert_eq!(first.len(), 36);
    }
}
