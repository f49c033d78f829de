//! Lines, dots and letters into an [`Image`]: enough to annotate a camera picture, with no font file and no
//! library.
//!
//! In: places in pixels (column, row), colours. Letters are 5 x 7 dots, capitals only; unknown characters
//! become a box. Whatever lies outside the picture, or is no number, is not drawn. Pure.

use cell_values::image::Image;

/// Coordinates beyond this are off any picture; the line is not worth walking.
const FAR: f64 = 50_000.0;

/// A straight line, `thick` pixels wide.
pub fn line(image: &mut Image, from: [f64; 2], to: [f64; 2], colour: [u8; 3], thick: i64) {
    if !from.iter().chain(&to).all(|value| value.abs() < FAR) {
        return;
    }
    let steps = (to[0] - from[0]).abs().max((to[1] - from[1]).abs()).ceil().max(1.0);
    for i in 0..=steps as u64 {
        let t = i as f64 / steps;
        let at = [from[0] + t * (to[0] - from[0]), from[1] + t * (to[1] - from[1])];
        square(image, at, thick, colour);
    }
}

/// A filled disc.
pub fn dot(image: &mut Image, at: [f64; 2], radius: i64, colour: [u8; 3]) {
    if !at.iter().all(|value| value.abs() < FAR) {
        return;
    }
    let (x, y) = (at[0].round() as i64, at[1].round() as i64);
    for dy in -radius..=radius {
        for dx in -radius..=radius {
            if dx * dx + dy * dy <= radius * radius {
                set(image, x + dx, y + dy, colour);
            }
        }
    }
}

/// A word centred at `at`, every dot `scale` pixels wide, with a dark rim so that it reads on any ground.
pub fn text(image: &mut Image, at: [f64; 2], word: &str, colour: [u8; 3], scale: i64) {
    if !at.iter().all(|value| value.abs() < FAR) {
        return;
    }
    let letters: Vec<[u8; 7]> = word.chars().take(40).map(glyph).collect();
    let width = 6 * scale * letters.len() as i64;
    let (left, top) = (at[0].round() as i64 - width / 2, at[1].round() as i64 - 7 * scale / 2);
    let mut dots = Vec::new();
    for (index, rows) in letters.iter().enumerate() {
        for (row, bits) in rows.iter().enumerate() {
            for column in 0..5 {
                if bits & (0b10000 >> column) != 0 {
                    dots.push((left + scale * (6 * index as i64 + column), top + scale * row as i64));
                }
            }
        }
    }
    for (rim, colour) in [(1, [0, 0, 0]), (0, colour)] {
        for &(x, y) in &dots {
            for dy in -rim..scale + rim {
                for dx in -rim..scale + rim {
                    set(image, x + dx, y + dy, colour);
                }
            }
        }
    }
}

/// `edge` x `edge` pixels round a point; the point's own pixel is among them.
fn square(image: &mut Image, at: [f64; 2], edge: i64, colour: [u8; 3]) {
    let (x, y) = (at[0].round() as i64, at[1].round() as i64);
    let before = (edge - 1) / 2;
    for dy in -before..edge - before {
        for dx in -before..edge - before {
            set(image, x + dx, y + dy, colour);
        }
    }
}

fn set(image: &mut Image, x: i64, y: i64, colour: [u8; 3]) {
    if let (Ok(x), Ok(y)) = (u32::try_from(x), u32::try_from(y)) {
        image.set_pixel(x, y, colour);
    }
}

/// Seven rows of five dots, the leftmost the highest bit.
#[rustfmt::skip]
fn glyph(letter: char) -> [u8; 7] {
    match letter.to_ascii_uppercase() {
        '0' => [0b01110, 0b10001, 0b10011, 0b10101, 0b11001, 0b10001, 0b01110],
        '1' => [0b00100, 0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110],
        '2' => [0b01110, 0b10001, 0b00001, 0b00110, 0b01000, 0b10000, 0b11111],
        '3' => [0b11110, 0b00001, 0b00001, 0b01110, 0b00001, 0b00001, 0b11110],
        '4' => [0b00010, 0b00110, 0b01010, 0b10010, 0b11111, 0b00010, 0b00010],
        '5' => [0b11111, 0b10000, 0b11110, 0b00001, 0b00001, 0b10001, 0b01110],
        '6' => [0b00110, 0b01000, 0b10000, 0b11110, 0b10001, 0b10001, 0b01110],
        '7' => [0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b01000, 0b01000],
        '8' => [0b01110, 0b10001, 0b10001, 0b01110, 0b10001, 0b10001, 0b01110],
        '9' => [0b01110, 0b10001, 0b10001, 0b01111, 0b00001, 0b00010, 0b01100],
        'A' => [0b01110, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001],
        'B' => [0b11110, 0b10001, 0b10001, 0b11110, 0b10001, 0b10001, 0b11110],
        'C' => [0b01110, 0b10001, 0b10000, 0b10000, 0b10000, 0b10001, 0b01110],
        'D' => [0b11110, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b11110],
        'E' => [0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b11111],
        'F' => [0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b10000],
        'G' => [0b01110, 0b10001, 0b10000, 0b10111, 0b10001, 0b10001, 0b01111],
        'H' => [0b10001, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001],
        'I' => [0b01110, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110],
        'J' => [0b00111, 0b00010, 0b00010, 0b00010, 0b00010, 0b10010, 0b01100],
        'K' => [0b10001, 0b10010, 0b10100, 0b11000, 0b10100, 0b10010, 0b10001],
        'L' => [0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b11111],
        'M' => [0b10001, 0b11011, 0b10101, 0b10101, 0b10001, 0b10001, 0b10001],
        'N' => [0b10001, 0b11001, 0b10101, 0b10011, 0b10001, 0b10001, 0b10001],
        'O' => [0b01110, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01110],
        'P' => [0b11110, 0b10001, 0b10001, 0b11110, 0b10000, 0b10000, 0b10000],
        'Q' => [0b01110, 0b10001, 0b10001, 0b10001, 0b10101, 0b10010, 0b01101],
        'R' => [0b11110, 0b10001, 0b10001, 0b11110, 0b10100, 0b10010, 0b10001],
        'S' => [0b01111, 0b10000, 0b10000, 0b01110, 0b00001, 0b00001, 0b11110],
        'T' => [0b11111, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100],
        'U' => [0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01110],
        'V' => [0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01010, 0b00100],
        'W' => [0b10001, 0b10001, 0b10001, 0b10101, 0b10101, 0b11011, 0b10001],
        'X' => [0b10001, 0b10001, 0b01010, 0b00100, 0b01010, 0b10001, 0b10001],
        'Y' => [0b10001, 0b10001, 0b01010, 0b00100, 0b00100, 0b00100, 0b00100],
        'Z' => [0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b10000, 0b11111],
        '-' => [0, 0, 0, 0b11111, 0, 0, 0],
        '_' => [0, 0, 0, 0, 0, 0, 0b11111],
        '.' => [0, 0, 0, 0, 0, 0b01100, 0b01100],
        ',' => [0, 0, 0, 0, 0b00100, 0b00100, 0b01000],
        ':' => [0, 0b01100, 0b01100, 0, 0b01100, 0b01100, 0],
        '+' => [0, 0b00100, 0b00100, 0b11111, 0b00100, 0b00100, 0],
        '/' => [0b00001, 0b00001, 0b00010, 0b00100, 0b01000, 0b10000, 0b10000],
        '?' => [0b01110, 0b10001, 0b00001, 0b00110, 0b00100, 0, 0b00100],
        '!' => [0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0, 0b00100],
        ' ' => [0; 7],
        _ => [0b11111, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b11111],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_letter_keeps_its_shape() {
        let mut image = Image::filled(12, 12, [9; 3]);
        text(&mut image, [6.0, 6.0], "L", [255; 3], 1);
        let lit: Vec<u32> = (0..12)
            .map(|y| (0..12).filter(|&x| image.pixel(x, y) == Some([255; 3])).count() as u32)
            .filter(|&count| count > 0)
            .collect();
        assert_eq!(lit, [1, 1, 1, 1, 1, 1, 5]);
    }

    #[test]
    fn a_line_joins_its_ends() {
        let mut image = Image::filled(20, 20, [0; 3]);
        line(&mut image, [2.0, 3.0], [17.0, 9.0], [255; 3], 1);
        let lit = image.rgb.chunks_exact(3).filter(|p| p[0] == 255).count();
        assert_eq!((image.pixel(2, 3), image.pixel(17, 9), lit), (Some([255; 3]), Some([255; 3]), 16));
    }
}
