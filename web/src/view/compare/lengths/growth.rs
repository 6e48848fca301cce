//! Growth of latency with length, in words.

use peernet_analysis::answer_length::Growth;
use peernet_statistics::number::{Estimate, SPACE, count};

/// Describes the slope and its interval in a sentence. `what` names the unit of length, and `each` is the length of this unit in measured units.
pub(super) fn sentence(growth: &Growth, what: &str, each: f64) -> String {
    let Growth { fit, interval } = growth;
    let (value, lo, hi) = (fit.slope.value * each, interval.0 * each, interval.1 * each);
    let (magnitude, near, far) = (value.abs(), lo.abs().min(hi.abs()), lo.abs().max(hi.abs()));
    let more = if value > 0.0 { "more" } else { "less" };
    let statement = if growth.is_significant() {
        let slope = Estimate::new(magnitude, (near, far));
        let interval = slope.between();
        if growth.is_imprecise() {
            format!("Each further {what} takes {interval}{SPACE}ms {more} (95{SPACE}%)")
        } else {
            let value = slope.value();
            format!("Each further {what} takes {value}{SPACE}ms {more} (95{SPACE}%: {interval})")
        }
    } else {
        let interval = Estimate::new(value, (lo, hi)).between();
        format!(
            "Whether longer answers take longer cannot be told: {interval}{SPACE}ms more per {what} (95{SPACE}%)"
        )
    };
    format!("{statement}, by Theil–Sen through {} iterations.", count(fit.points as u64))
}
