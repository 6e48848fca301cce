//! The embedded font.

use std::sync::LazyLock;

use peernet_sample::printable_line;
use ttf_parser::Face;

/// Family of the font. An SVG file lists substitutes after this family, for programs that do not have the font.
pub const FAMILY: &str = "Inter";
/// Font of the dashboard in one weight, with the glyphs that figures use. `assets/instance.py` makes it.
pub const FONT: &[u8] = include_bytes!("../../assets/inter.ttf");

/// Assumed advance (width) of a character that the font lacks, as a share of the type size. A wide letter has about
/// this advance.
const UNKNOWN_ADVANCE: f64 = 0.7;

/// Advances of the characters of Latin-1, as shares of the type size. The advances of other characters are looked up in
/// the font each time.
static ADVANCES: LazyLock<[f64; 0x100]> = LazyLock::new(|| {
    std::array::from_fn(|code| char::from_u32(code as u32).and_then(advance).unwrap_or(UNKNOWN_ADVANCE))
});

static FACE: LazyLock<Option<Face<'static>>> = LazyLock::new(|| Face::parse(FONT, 0).ok());

fn advance(character: char) -> Option<f64> {
    let face = FACE.as_ref()?;
    let advance = face.glyph_hor_advance(face.glyph_index(character)?)?;
    Some(f64::from(advance) / f64::from(face.units_per_em()))
}

/// Returns the width of a line of text, in the unit of the type size. The width ignores kerning, which would make the
/// text narrower by less than 1 %.
pub fn width(text: &str, size: f64) -> f64 {
    let cached_advance = |character: char| {
        ADVANCES
            .get(character as usize)
            .copied()
            .unwrap_or_else(|| advance(character).unwrap_or(UNKNOWN_ADVANCE))
    };
    printable_line(text).chars().map(cached_advance).sum::<f64>() * size
}

/// Returns the first character of a text for which the font has no glyph; `None` if the font has glyphs for all
/// characters.
pub fn missing_glyph(text: &str) -> Option<char> {
    printable_line(text).chars().find(|character| advance(*character).is_none())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_width_follows_advances_of_the_font() {
        assert!(width("iterations", 7.0) > width("iter", 7.0));
        assert!((width("HH", 10.0) - 2.0 * width("H", 10.0)).abs() < 1e-9);
        // Inter's H is 0.744 of the type size wide.
        assert!((0.70..0.78).contains(&width("H", 1.0)), "{}", width("H", 1.0));
        assert!(width("→", 1.0) > 0.5 && width("\u{1F600}", 1.0) == UNKNOWN_ADVANCE);
    }

    #[test]
    fn characters_missing_in_font_are_reported() {
        assert_eq!(missing_glyph("Latency, ms (−5 ± 2 µs) → ≤ × ÷ · “n”\u{202f}…"), None);
        assert_eq!(missing_glyph("latency 延迟"), Some('延'));
    }
}
