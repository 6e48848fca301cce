//! The median of a quantity in one run, with its uncertainty by the hosts' clocks.

use peernet_analysis::delays::ClockedSummaries;
use peernet_analysis::summary::Scale;
use peernet_clock::Verdict;
use peernet_logger::{Name, stage};
use peernet_statistics::number::{SPACE, interval_ms, throughput_between, within_ms};
use peernet_store::MergeableStatistics;

use crate::view::chip::Chip;
use crate::view::clocks;
use crate::view::units::shown_in;

/// Quantities that depend on two clocks, each with the delay that it is computed from.
pub(super) static DELAY_OF_QUANTITY: [(Name, Name); 4] = [
    (stage::UPLOAD, stage::UPLOAD),
    (stage::DOWNLOAD, stage::DOWNLOAD),
    (stage::UPLOAD_THROUGHPUT, stage::UPLOAD),
    (stage::DOWNLOAD_THROUGHPUT, stage::DOWNLOAD),
];

/// A median in words.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Median {
    /// Median with its unit and its uncertainty by the clocks. Only the interval if the uncertainty is too large for a single value.
    pub text: String,
    /// Interval of the median by the clock bounds, in the SI unit; `None` without uncertainty.
    pub within: Option<(f64, f64)>,
    /// Verdict that needs attention.
    pub doubt: Option<Chip>,
}

impl Median {
    /// Returns the median of a node's values. `unit` is their SI unit. `None` without values.
    pub(super) fn of(mergeable: &MergeableStatistics, name: &str, unit: &str) -> Option<Self> {
        let value = mergeable.summary(name)?.quantile(0.5)?;
        let delay = DELAY_OF_QUANTITY.iter().find(|(quantity, _)| *quantity == *name).map(|(_, delay)| delay);
        let bound = delay.and_then(|delay| mergeable.bound(delay));
        let verdict = bound.as_ref().and_then(clocks::verdict).filter(|verdict| *verdict != Verdict::Ok);
        let ends = delay.and_then(|delay| interval(mergeable, name, delay));
        let shown = shown_in(unit);
        let text = match (ends, verdict) {
            (None, _) => format!("median {}", with_unit(&without_unit(unit, value), &shown.0)),
            (Some(ends), None) => {
                let value = if unit == "s" {
                    within_ms(value, with_infinite_end(ends))
                } else {
                    without_unit(unit, value)
                };
                format!("median {}, by the clocks {}", with_unit(&value, &shown.0), between(unit, ends))
            }
            (Some(ends), Some(_)) => {
                format!("median by the clocks {}", with_unit(&between(unit, ends), &shown.0))
            }
        };
        Some(Self { text, within: ends.map(with_infinite_end), doubt: verdict.map(Chip::verdict) })
    }
}

/// Returns the interval of the median by the clock bounds of the delay; `None` if it is not known or has no width.
fn interval(mergeable: &MergeableStatistics, name: &str, delay: &Name) -> Option<(f64, Option<f64>)> {
    let values = mergeable.summary(name)?;
    let (delays, half_widths) = (mergeable.summary(delay)?, mergeable.half_widths(delay)?);
    let clocked = ClockedSummaries { values, delays, half_widths };
    let ends = if delay == name {
        clocked.interval_of_median_delay().map(|(lo, hi)| (lo, Some(hi)))
    } else {
        clocked.interval_of_median_throughput()
    };
    ends.filter(|(lo, hi)| *hi != Some(*lo))
}

fn with_infinite_end((lo, hi): (f64, Option<f64>)) -> (f64, f64) {
    (lo, hi.unwrap_or(f64::INFINITY))
}

fn with_unit(value: &str, unit: &str) -> String {
    if unit.is_empty() { value.to_owned() } else { format!("{value}{SPACE}{unit}") }
}

/// Returns a value without its unit.
fn without_unit(unit: &str, value: f64) -> String {
    Scale::for_unit(unit).format(value)
}

/// Formats both ends. A no-break space before the dash keeps the dash from beginning a line.
fn between(unit: &str, ends: (f64, Option<f64>)) -> String {
    let (lo, hi) = with_infinite_end(ends);
    let text = if unit == "bit/s" { throughput_between(ends) } else { interval_ms(lo, hi) };
    text.replace(" –", "\u{a0}–")
}

#[cfg(test)]
mod tests {
    use peernet_statistics::Summary;

    use super::*;

    fn mergeable(half_ms: f64, verdict: Verdict) -> MergeableStatistics {
        let of = |value: f64| {
            let mut all = Summary::default();
            (0..100).for_each(|_| all.record(value));
            all
        };
        let mut mergeable = MergeableStatistics::default();
        mergeable.add(stage::UPLOAD, "s", &of(0.006));
        mergeable.add(stage::UPLOAD_THROUGHPUT, "bit/s", &of(2e8));
        mergeable.add(stage::SENSING, "s", &of(0.000_126));
        mergeable.add_half_widths(stage::UPLOAD, &of(half_ms / 1e3));
        mergeable.add_verdicts(stage::UPLOAD, verdict, 100);
        mergeable
    }

    fn median_text(mergeable: &MergeableStatistics, name: &Name, unit: &str) -> (String, bool) {
        let median = Median::of(mergeable, name, unit).expect("samples");
        (median.text.replace(SPACE, " ").replace('\u{a0}', " "), median.doubt.is_some())
    }

    #[test]
    fn median_delay_has_interval_by_clock_bounds() {
        let statistics = mergeable(0.5, Verdict::Ok);
        assert_eq!(
            median_text(&statistics, &stage::UPLOAD, "s"),
            ("median 6.00 ms, by the clocks 5.50 – 6.50".to_owned(), false)
        );
        let (text, _) = median_text(&statistics, &stage::UPLOAD_THROUGHPUT, "bit/s");
        assert_eq!(text, "median 25.0 MB/s, by the clocks 23.1 – 27.3");
        assert_eq!(median_text(&statistics, &stage::SENSING, "s"), ("median 0.126 ms".to_owned(), false));
        assert_eq!(Median::of(&statistics, "queue", "s"), None);
        let exact = mergeable(0.0, Verdict::Ok);
        assert_eq!(median_text(&exact, &stage::UPLOAD, "s"), ("median 6.00 ms".to_owned(), false));
    }

    #[test]
    fn limited_delay_is_interval_with_verdict() {
        let wide = mergeable(8.0, Verdict::Limited);
        assert_eq!(
            median_text(&wide, &stage::UPLOAD, "s"),
            ("median by the clocks 0.0 – 14.0 ms".to_owned(), true)
        );
        let median = Median::of(&wide, &stage::UPLOAD_THROUGHPUT, "bit/s").expect("samples");
        assert!(median.text.ends_with("≥ 10.7\u{202f}MB/s") && median.doubt.is_some(), "{median:?}");
        assert_eq!(median.within.expect("bounded").1, f64::INFINITY);
    }
}
