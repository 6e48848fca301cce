//! The median of a quantity in one run, with the bounds that follow from the uncertainty of the hosts' clocks.

use peernet_analysis::delays::{ClockInterval, ClockedSummaries};
use peernet_analysis::summary::Scale;
use peernet_analysis::transfer::DirectionNodes;
use peernet_clock::Verdict;
use peernet_logger::Name;
use peernet_statistics::number::{SPACE, interval_ms, is_exact, throughput_between, within_ms};
use peernet_store::MergeableStatistics;

use crate::view::chip::Chip;
use crate::view::clocks;
use crate::view::units::display_unit;

/// Returns the delay that a quantity is computed from; `None` if the quantity does not depend on two clocks.
pub(super) fn delay_of_quantity(quantity: &str) -> Option<&'static Name> {
    let is_of_direction = |nodes: &&DirectionNodes| nodes.delay == *quantity || nodes.throughput == *quantity;
    DirectionNodes::both().into_iter().find(is_of_direction).map(|nodes| &nodes.delay)
}

/// A median as a page shows it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Median {
    /// Median with its unit, and its interval by the clock bounds. If the verdict on the clock
    /// bounds needs attention, the text has only the interval.
    pub text: String,
    /// Interval of the median by the clock bounds, in the SI unit; `None` without uncertainty.
    pub clock_interval: Option<(f64, f64)>,
    /// Verdict on the clock bounds; `None` if it needs no attention.
    pub verdict_chip: Option<Chip>,
}

impl Median {
    /// Returns the median of a node's values. `unit` is their SI unit. `None` without values.
    pub(super) fn of(mergeable: &MergeableStatistics, name: &str, unit: &str) -> Option<Self> {
        let value = mergeable.summary(name)?.quantile(0.5)?;
        let delay = delay_of_quantity(name);
        let bound = delay.and_then(|delay| mergeable.bound(delay));
        let verdict = bound.as_ref().and_then(clocks::verdict).filter(|verdict| *verdict != Verdict::Ok);
        let interval = delay.and_then(|delay| median_interval(mergeable, name, delay));
        let (symbol, _) = display_unit(unit);
        let remark =
            interval.and_then(|interval| interval.method.remark()).map(|remark| format!(" ({remark})"));
        let remark = remark.unwrap_or_default();
        let text = match (interval, verdict) {
            (None, _) => format!("median {}", with_unit(&without_unit(unit, value), &symbol)),
            (Some(interval), None) => {
                let value =
                    if unit == "s" { within_ms(value, interval.ends()) } else { without_unit(unit, value) };
                let value = with_unit(&value, &symbol);
                format!("median {value}, clock bounds {}{remark}", format_interval(unit, interval))
            }
            (Some(interval), Some(_)) => {
                format!(
                    "median within the clock bounds {}{remark}",
                    with_unit(&format_interval(unit, interval), &symbol)
                )
            }
        };
        let clock_interval = interval.map(|interval| interval.ends());
        Some(Self { text, clock_interval, verdict_chip: verdict.map(Chip::verdict) })
    }
}

/// Returns the interval of the median by the clock bounds of the delay; `None` if it is not known or has no width.
fn median_interval(mergeable: &MergeableStatistics, name: &str, delay: &Name) -> Option<ClockInterval> {
    let clocked = ClockedSummaries {
        values: mergeable.summary(name)?,
        ends: mergeable.ends(name),
        delays: mergeable.summary(delay)?,
        half_widths: mergeable.half_widths(delay),
    };
    let interval = if delay == name {
        clocked.interval_of_median_delay()
    } else {
        clocked.interval_of_median_throughput()
    };
    interval.filter(|interval| !is_exact(interval.hi - interval.lo))
}

fn with_unit(value: &str, unit: &str) -> String {
    if unit.is_empty() { value.to_owned() } else { format!("{value}{SPACE}{unit}") }
}

/// Returns a value without its unit.
fn without_unit(unit: &str, value: f64) -> String {
    Scale::for_unit(unit).format(value)
}

/// Formats both ends of an interval without their unit. A no-break space before the dash keeps the dash from beginning
/// a line.
fn format_interval(unit: &str, ClockInterval { lo, hi, .. }: ClockInterval) -> String {
    let text = if unit == "bit/s" { throughput_between((lo, Some(hi))) } else { interval_ms(lo, hi) };
    text.replace(" –", "\u{a0}–")
}

#[cfg(test)]
mod tests {
    use peernet_logger::stage;
    use peernet_statistics::Summary;

    use super::*;

    const WITH_ENDS: bool = true;
    const WITHOUT_ENDS: bool = false;

    fn mergeable(half_ms: f64, verdict: Verdict, has_ends: bool) -> MergeableStatistics {
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
        if has_ends {
            let (lo, hi) = ((0.006 - half_ms / 1e3).max(0.0), 0.006 + half_ms / 1e3);
            mergeable.add_ends(stage::UPLOAD, [&of(lo), &of(hi)]);
            let rate = |seconds: f64| of(if seconds > 0.0 { 1.2e6 / seconds } else { f64::INFINITY });
            mergeable.add_ends(stage::UPLOAD_THROUGHPUT, [&rate(hi), &rate(lo)]);
        }
        mergeable.add_verdicts(stage::UPLOAD, verdict, 100);
        mergeable
    }

    /// Returns the text of the median, and whether the median has a chip.
    fn median_text(mergeable: &MergeableStatistics, name: &Name, unit: &str) -> (String, bool) {
        let median = Median::of(mergeable, name, unit).expect("samples");
        (median.text.replace(SPACE, " ").replace('\u{a0}', " "), median.verdict_chip.is_some())
    }

    #[test]
    fn median_delay_has_interval_by_clock_bounds() {
        let statistics = mergeable(0.5, Verdict::Ok, WITH_ENDS);
        assert_eq!(
            median_text(&statistics, &stage::UPLOAD, "s"),
            ("median 6.00 ms, clock bounds 5.50 – 6.50".to_owned(), false)
        );
        let (text, _) = median_text(&statistics, &stage::UPLOAD_THROUGHPUT, "bit/s");
        assert_eq!(text, "median 25.0 MB/s, clock bounds 23.1 – 27.3");
        assert_eq!(median_text(&statistics, &stage::SENSING, "s"), ("median 0.126 ms".to_owned(), false));
        assert_eq!(Median::of(&statistics, "queue", "s"), None);
        let exact = mergeable(0.0, Verdict::Ok, WITH_ENDS);
        assert_eq!(median_text(&exact, &stage::UPLOAD, "s"), ("median 6.00 ms".to_owned(), false));
    }

    #[test]
    fn interval_from_half_widths_names_its_method() {
        // The run was stored by an earlier version, which stored no ends of intervals.
        let statistics = mergeable(0.5, Verdict::Ok, WITHOUT_ENDS);
        assert_eq!(
            median_text(&statistics, &stage::UPLOAD, "s").0,
            "median 6.00 ms, clock bounds 5.50 – 6.50 (from half widths)"
        );
        let (text, _) = median_text(&statistics, &stage::UPLOAD_THROUGHPUT, "bit/s");
        assert_eq!(text, "median 25.0 MB/s, clock bounds 23.1 – 27.3 (from half widths)");
        let wide = mergeable(8.0, Verdict::Limited, WITHOUT_ENDS);
        let (text, _) = median_text(&wide, &stage::UPLOAD, "s");
        assert_eq!(text, "median within the clock bounds 0.0 – 14.0 ms (from half widths)");
    }

    #[test]
    fn limited_delay_is_interval_with_verdict() {
        let wide = mergeable(8.0, Verdict::Limited, WITH_ENDS);
        assert_eq!(
            median_text(&wide, &stage::UPLOAD, "s"),
            ("median within the clock bounds 0.0 – 14.0 ms".to_owned(), true)
        );
        let median = Median::of(&wide, &stage::UPLOAD_THROUGHPUT, "bit/s").expect("samples");
        assert!(median.text.ends_with("≥ 10.7\u{202f}MB/s") && median.verdict_chip.is_some(), "{median:?}");
        assert_eq!(median.clock_interval.expect("bounded").1, f64::INFINITY);
    }
}
