//! Minimum widths of pictures at which their text fits, for pictures that grow with their panel on a page.
//!
//! The server does not know the width of a page. Each text therefore has the class of a minimum width, and the style
//! sheet hides the text in narrower pictures, because a clipped number would be a wrong number.

use super::width;

/// Minimum widths, rem: the classes `w8`, `w10` and so on of the style sheet.
pub const WIDTH_STEPS: [u16; 14] = [8, 10, 12, 15, 18, 21, 25, 30, 36, 43, 52, 62, 75, 90];

/// Type size of axes and of text in pictures, rem.
const SIZE: f64 = 0.6875;
/// Factor by which text in bars is wider than [`width`] says, because the text has a greater weight than the embedded
/// font. [`width_rem`] applies the factor to all text.
const WEIGHT_FACTOR: f64 = 1.03;
/// Space around a text, rem.
const SPACE: f64 = 0.3;

/// Returns the width of a text in a picture including the space around it, rem.
pub fn width_rem(text: &str) -> f64 {
    width(text, SIZE) * WEIGHT_FACTOR + SPACE
}

/// Returns the smallest of [`WIDTH_STEPS`] that is at least `width_rem`; `None` if all steps are smaller.
pub fn width_step(width_rem: f64) -> Option<u16> {
    WIDTH_STEPS.into_iter().find(|step| f64::from(*step) >= width_rem)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn style_sheet_has_rule_for_every_width() {
        let sheet = include_str!("../../../../web/assets/css/pictures.css");
        for step in WIDTH_STEPS {
            let rule =
                format!("@container (min-width: {step}rem) {{ .fits.w{step} {{ display: inline; }} }}");
            assert!(sheet.contains(&rule), "no rule: {rule}");
        }
    }
}
