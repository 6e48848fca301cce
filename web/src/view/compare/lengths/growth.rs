//! How latency grows with length.

use peernet_analysis::fit::{Fit, Point, theil_sen};
use peernet_statistics::number::{Estimate, SPACE, count};

/// Fewest iterations that a line is drawn through.
const FEWEST: usize = 60;
/// An interval that is wider than this share of a slope does not tell the slope.
const TELLING: f64 = 0.5;

/// A line through latencies over lengths.
pub(super) struct Growth {
    fit: Fit,
    /// The 95 % interval of its slope.
    pub(super) interval: (f64, f64),
}

impl Growth {
    /// The line whose slope is the median of those of all pairs of iterations (`peernet_analysis::fit`): whatever the tail of
    /// the latencies and the distribution of the lengths, late answers hardly move it. `None` where there are too few.
    pub(super) fn of(points: &[(f64, f64)]) -> Option<Self> {
        (points.len() >= FEWEST).then_some(())?;
        let points: Vec<Point> = points.iter().map(|(x, y)| Point { x: *x, y: *y }).collect();
        let fit = theil_sen(&points)?;
        Some(Self { interval: fit.slope.interval?, fit })
    }

    /// Whether zero lies outside the interval of the slope.
    fn is_certain(&self) -> bool {
        self.interval.0 > 0.0 || self.interval.1 < 0.0
    }

    pub(super) fn line(&self) -> Option<(f64, f64)> {
        self.is_certain().then_some((self.fit.intercept.value, self.fit.slope.value))
    }

    /// Of so many measured units of length, which are one `what`.
    pub(super) fn sentence(&self, what: &str, each: f64) -> String {
        let (value, lo, hi) = (self.fit.slope.value * each, self.interval.0 * each, self.interval.1 * each);
        let (size, near, far) = (value.abs(), lo.abs().min(hi.abs()), lo.abs().max(hi.abs()));
        let more = if value > 0.0 { "more" } else { "less" };
        let found = if !self.is_certain() {
            let interval = Estimate::new(value, (lo, hi)).between();
            format!(
                "Whether longer answers take longer cannot be told: {interval}{SPACE}ms more per {what} (95{SPACE}%)"
            )
        } else {
            let slope = Estimate::new(size, (near, far));
            let interval = slope.between();
            if far - near > TELLING * size {
                format!("Each further {what} takes {interval}{SPACE}ms {more} (95{SPACE}%)")
            } else {
                let value = slope.value();
                format!("Each further {what} takes {value}{SPACE}ms {more} (95{SPACE}%: {interval})")
            }
        };
        format!("{found}, by Theil–Sen through {} iterations.", count(self.fit.points as u64))
    }
}
