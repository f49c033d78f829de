//! One colour an object, in every picture: from its place in the catalogue or instance.
//!
//! In: an index, and for what. Out: a CSS colour. Hues differ between neighbours; after twelve objects the
//! lightness changes too. Labels say what colours alone do not. Pure.

use cell_values::hue::hue_deg;

/// Distinct on light and dark ground, for outlines and fills.
pub fn of(index: usize) -> String {
    let lightness = [46, 54, 40][index / 12 % 3];
    shade(index, lightness)
}

/// The same hue at another lightness, %.
pub fn shade(index: usize, lightness: u32) -> String {
    let hue = hue_deg(index);
    format!("hsl({hue:.0},58%,{lightness}%)")
}

/// The colour of [`of`] as red, green and blue, 0 to 1.
pub fn rgb(index: usize) -> [f64; 3] {
    let (hue, saturation) = (hue_deg(index), 0.58);
    let lightness = f64::from([46, 54, 40][index / 12 % 3]) / 100.0;
    // The standard conversion: each channel is a trapezoid over the hue.
    let amplitude = saturation * lightness.min(1.0 - lightness);
    [0.0, 8.0, 4.0].map(|offset| {
        let k: f64 = (offset + hue / 30.0) % 12.0;
        lightness - amplitude * (k - 3.0).min(9.0 - k).clamp(-1.0, 1.0)
    })
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
        // hsl(210, 58 %, 46 %), as browsers show it.
        for (channel, shown) in rgb(0).into_iter().zip([49.0, 117.0, 185.0]) {
            assert!((channel * 255.0 - shown).abs() < 1.0, "{channel} {shown}");
        }
        let first: std::collections::BTreeSet<_> = (0..36).map(of).collect();
        assert_eq!(first.len(), 36);
    }
}
