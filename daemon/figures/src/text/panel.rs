//! Text in pictures that grow with their panel on a page: the minimum width of the picture for it.
//!
//! The server does not know the width of a page. So the text has a class for its minimum width, and the style sheet hides it below that
//! width, because a clipped number would be a wrong number.

use super::width;

/// Minimum widths of a picture in which text is shown, rem: the classes `w8`, `w10` and so on of the style sheet.
pub const WIDTH_STEPS: [u16; 14] = [8, 10, 12, 15, 18, 21, 25, 30, 36, 43, 52, 62, 75, 90];

/// Type size of axes and of text in pictures, rem.
const SIZE: f64 = 0.6875;
/// Factor by which text in bars is wider than measured, because it has a greater weight than the measured font.
const HEAVIER: f64 = 1.03;
/// Space about a text, rem.
const ABOUT: f64 = 0.3;

/// Returns the width of a text in pictures with the space about it, rem.
pub fn rem(words: &str) -> f64 {
    width(words, SIZE) * HEAVIER + ABOUT
}

/// Returns the first of [`WIDTH_STEPS`] that is at least `needs` rem; `None` if all are smaller.
pub fn width_step(needs: f64) -> Option<u16> {
    WIDTH_STEPS.into_iter().find(|step| f64::from(*step) >= needs)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_style_sheet_knows_every_width() {
        let sheet = include_str!("../../../../web/assets/css/pictures.css");
        for step in WIDTH_STEPS {
            let rule =
                format!("@container (min-width: {step}rem) {{ .fits.w{step} {{ display: inline; }} }}");
            assert!(sheet.contains(&rule), "no rule: {rule}");
        }
    }
}
