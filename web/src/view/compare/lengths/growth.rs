//! How latency grows with length.

use peernet_report::fit::{Fit, Point, Weighted, least_squares};
use peernet_report::order::Ordered;

use crate::numbers::{SPACE, count, interval_ms, within_ms};

/// Iterations of similar length that have a median, and the fewest and the most such classes that a line is fitted to.
const CLASS: usize = 20;
const CLASSES: (usize, usize) = (3, 20);
/// No median is known better than a clock is read: a tenth of a microsecond.
const CLOCK_READ: f64 = 1e-7;
/// An interval that is wider than this share of a slope does not tell the slope.
const TELLING: f64 = 0.5;

/// A line through latencies over lengths.
pub(super) struct Growth {
    fit: Fit,
    iterations: usize,
}

impl Growth {
    /// A line through the medians of classes of similar length, each weighted by how well it is known: sound whatever the
    /// tail of the latencies (`peernet_report::fit`). `None` where there are too few.
    pub(super) fn of(points: &[(f64, f64)]) -> Option<Self> {
        let classes = (points.len() / CLASS).min(CLASSES.1);
        (classes >= CLASSES.0).then_some(())?;
        let mut sorted = points.to_vec();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        let class = |at: usize| {
            let class = &sorted[at * sorted.len() / classes..(at + 1) * sorted.len() / classes];
            let latencies: Ordered = class.iter().map(|(_, seconds)| *seconds).collect();
            let x = class.iter().map(|(length, _)| length).sum::<f64>() / class.len() as f64;
            let point = Point { x, y: latencies.median()? };
            Some(Weighted { point, weight: latencies.median_error()?.max(CLOCK_READ).powi(-2) })
        };
        let medians: Option<Vec<Weighted>> = (0..classes).map(class).collect();
        Some(Self { fit: least_squares(&medians?)?, iterations: points.len() })
    }

    /// Whether zero lies outside the interval of the slope.
    fn is_certain(&self) -> bool {
        let (lo, hi) = self.fit.slope.span();
        lo > 0.0 || hi < 0.0
    }

    pub(super) fn line(&self) -> Option<(f64, f64)> {
        self.is_certain().then_some((self.fit.intercept.value, self.fit.slope.value))
    }

    /// Of so many measured units of length, which are one `what`.
    pub(super) fn sentence(&self, what: &str, each: f64) -> String {
        let (lo, hi) = self.fit.slope.span();
        let (value, lo, hi) = (self.fit.slope.value * each, lo * each, hi * each);
        let (size, near, far) = (value.abs(), lo.abs().min(hi.abs()), lo.abs().max(hi.abs()));
        let more = if value > 0.0 { "more" } else { "less" };
        let interval = interval_ms(near, far);
        let found = if !self.is_certain() {
            let interval = interval_ms(lo, hi);
            format!(
                "Whether longer answers take longer cannot be told: {interval}{SPACE}ms more per {what} (95{SPACE}%)"
            )
        } else if far - near > TELLING * size {
            format!("Each further {what} takes {interval}{SPACE}ms {more} (95{SPACE}%)")
        } else {
            let value = within_ms(size, (near, far));
            format!("Each further {what} takes {value}{SPACE}ms {more} (95{SPACE}%: {interval})")
        };
        format!(
            "{found}, by a line through the medians of {} classes of length, each weighted by how well it is known, of {} \
             iterations.",
            self.fit.points,
            count(self.iterations as u64)
        )
    }
}
