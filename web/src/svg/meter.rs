//! Bar that shows a share of a limit.

use askama::Template;

use super::Percent;

/// Share from which on the meter is marked as nearly full.
const NEARLY: f64 = 0.9;

/// A bar from nothing to the limit.
#[derive(Clone, Debug, PartialEq, Template)]
#[template(path = "svg/meter.html")]
pub(crate) struct Meter {
    label: String,
    width: Percent,
    full: bool,
}

impl askama::filters::HtmlSafe for Meter {}

impl Meter {
    /// Draws a share, 0 to 1. A share above zero has a visible width.
    pub(crate) fn new(label: String, share: f64) -> Self {
        let share = if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 };
        let width = if share > 0.0 { (share * 100.0).max(2.0) } else { 0.0 };
        Self { label, width: Percent(width), full: share >= NEARLY }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_little_can_be_seen_and_too_much_stays_inside() {
        let width = |share| Meter::new("spool".into(), share).width;
        assert_eq!(
            [0.0, 0.001, 0.5, 7.0, f64::NAN].map(width).map(|width| width.0),
            [0.0, 2.0, 50.0, 100.0, 0.0]
        );
        assert!(Meter::new("spool".into(), 0.95).full && !Meter::new("spool".into(), 0.5).full);
    }
}
