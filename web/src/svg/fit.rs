//! Text inside pictures that grow with their panel: the width of the picture that it needs.
//!
//! The server does not know the width of a page. Text therefore carries the smallest width at which it fits, and the style sheet shows it
//! from that width on, because a figure that is cut off is a wrong figure.

/// Widths of a picture, rem, from which on text is shown: the classes `w8`, `w10` and so on of the style sheet.
const STEPS: [u16; 14] = [8, 10, 12, 15, 18, 21, 25, 30, 36, 43, 52, 62, 75, 90];

/// An upper bound of a character's width and of the space about a text, rem, in the font of bars.
const CHARACTER: f64 = 0.4;
const ABOUT: f64 = 0.3;

/// Returns a text's width with the space about it, rem.
pub(super) fn width(text: &str) -> f64 {
    text.chars().count() as f64 * CHARACTER + ABOUT
}

/// A text with the width that it needs.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Fitted {
    text: String,
    /// The text's own width, rem.
    width: f64,
    /// The width of the whole picture from which on it fits, rem.
    needs: f64,
}

impl Fitted {
    /// Returns `text`, which is drawn next to `beside`, within `share` percent of the picture's width.
    pub(super) fn within(share: f64, text: String, beside: &str) -> Self {
        let width = width(&text) + beside.chars().count() as f64 * CHARACTER;
        Self { text, width, needs: width / share * 100.0 }
    }

    /// Returns a text that nothing limits.
    pub(super) fn anywhere(text: String) -> Self {
        Self { width: width(&text), text, needs: 0.0 }
    }

    /// Keeps the text clear of another at a distance of `distance` percent; both together take `taken` rem in between.
    pub(super) fn apart(&mut self, distance: f64, taken: f64) {
        self.needs = self.needs.max(taken / distance * 100.0);
    }

    /// Keeps the text, centred at `middle`, clear of the drawing between `from` and `to`, all in percent.
    pub(super) fn clear_of(&mut self, middle: f64, from: f64, to: f64) {
        let free = (from - middle).max(middle - to).max(0.0);
        self.apart(free, self.width / 2.0);
    }

    /// Returns the text, and the first of the style sheet's widths at which it fits; `None` if it fits in none.
    pub(super) fn shown(&self) -> Option<(&str, u16)> {
        let step = STEPS.into_iter().find(|step| f64::from(*step) >= self.needs)?;
        Some((&self.text, step))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(share: f64, text: &str, beside: &str) -> Option<u16> {
        Fitted::within(share, text.to_owned(), beside).shown().map(|(_, step)| step)
    }

    #[test]
    fn the_narrower_the_room_the_wider_the_picture_must_be() {
        assert_eq!(step(20.0, "2.6", ""), Some(8));
        assert_eq!(step(7.5, "2.6", ""), Some(21));
        assert_eq!(step(20.0, "preprocessing ", "2.6"), Some(36), "7.1 rem in a fifth of the picture");
        assert_eq!(step(0.5, "2.6", ""), None);
        assert_eq!(step(0.0, "2.6", ""), None);
    }

    #[test]
    fn what_is_drawn_over_a_text_leaves_it_room_or_none() {
        let mut text = Fitted::within(50.0, "2.6".to_owned(), "");
        text.clear_of(25.0, 31.0, 70.0);
        assert_eq!(text.shown(), Some(("2.6", 15)), "0.75 rem are to be 6 % or less");
        text.clear_of(25.0, 20.0, 70.0);
        assert_eq!(text.shown(), None);
    }

    #[test]
    fn the_style_sheet_knows_every_width() {
        let sheet = include_str!("../../assets/css/pictures.css");
        for step in STEPS {
            let rule =
                format!("@container (min-width: {step}rem) {{ .fits.w{step} {{ display: inline; }} }}");
            assert!(sheet.contains(&rule), "no rule: {rule}");
        }
    }
}
