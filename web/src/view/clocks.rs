//! Accuracy of one-way delays, in a cell of a table.

use peernet_clock::Verdict;
use peernet_statistics::number::{EXACT, bound_ms, interval_ms, is_exact};
use peernet_store::DelayAccuracy;
use peernet_stream::PlacementKind;

use super::chip::Chip;

/// The clock bound of a pipeline or run.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ClockCell {
    /// Bound, such as `±0.65`; `None` without a one-way delay or without a known bound.
    pub bound: Option<String>,
    /// The worse one of the verdicts on the two directions; `None` without delays.
    pub chip: Option<Chip>,
    /// Text that replaces the bound; empty if there is a bound or a verdict.
    pub words: &'static str,
    /// Explanation of the cell.
    pub title: &'static str,
}

/// Returns the verdict on the delays of one direction; `None` without delays. Bad verdicts on less than 5 % of the
/// delays are ignored ([`Verdict::summarise`]).
pub(crate) fn verdict(bound: &DelayAccuracy) -> Option<Verdict> {
    Verdict::summarise(bound.verdicts.iter().copied())
}

/// Formats the interval that contains a delay, in ms; `exact` if both ends of the message read one clock.
pub(crate) fn interval_text((lo, hi): (f64, f64)) -> String {
    if is_exact(hi - lo) { EXACT.to_owned() } else { interval_ms(lo, hi) }
}

/// Returns the meaning of a verdict, in a sentence for first-time readers.
pub(crate) const fn meaning(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Ok => {
            "the interval that contains the true delay is narrower than half the delay: take the figure as it is"
        }
        Verdict::Limited => {
            "sound, but the interval is wider than half the delay, or a jump of a clock was suspected in the 10 s before: \
             read it as an interval, not as a figure"
        }
        Verdict::Stale => {
            "too few exchanges at that time (fewer than three since the link came up or a clock was stepped, or none lately), so \
             the interval is wide; or the newest exchanges contradicted the others, as they do after a clock has jumped"
        }
        Verdict::Unsynchronised => {
            "nothing related the two hosts' clocks at that time, so the directions cannot be told apart; their sum is exact"
        }
        Verdict::Stepped => {
            "a clock was stepped or drifted faster than the limit at that time: leave these delays out"
        }
        Verdict::Inconsistent => {
            "what is known of the clocks contradicts itself, so a source is wrong or the clocks drift faster than the limit: \
             trust neither direction, only their sum"
        }
    }
}

impl ClockCell {
    /// Returns the cell for both directions together: the larger median bound and the worse verdict.
    pub(crate) fn of(kind: PlacementKind, bounds: &[DelayAccuracy]) -> Self {
        if kind != PlacementKind::Remote {
            let title = "one host: nothing crosses between clocks";
            return Self { bound: None, chip: None, words: "one host", title };
        }
        let verdict = Verdict::worst(bounds.iter().filter_map(verdict));
        let half_width = bounds.iter().filter_map(DelayAccuracy::median_half_width).max_by(f64::total_cmp);
        let chip = verdict.map(Chip::verdict);
        match (half_width, verdict) {
            (_, None) => Self {
                bound: None,
                chip,
                words: "no delays",
                title: "no one-way delay was measured in this time",
            },
            (None, Some(verdict)) => Self { bound: None, chip, words: "", title: meaning(verdict) },
            (Some(half_width), Some(verdict)) => {
                let title = if is_exact(half_width) { "both hosts read one clock" } else { meaning(verdict) };
                Self { bound: Some(bound_ms(half_width)), chip, words: "", title }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use peernet_logger::stage;

    use super::*;

    fn bound(verdicts: &[(Verdict, u64)]) -> DelayAccuracy {
        DelayAccuracy { stage: stage::UPLOAD, half_width: None, ends: None, verdicts: verdicts.to_vec() }
    }

    #[test]
    fn verdict_on_one_percent_of_delays_is_ignored() {
        assert_eq!(verdict(&bound(&[(Verdict::Ok, 990), (Verdict::Stepped, 10)])), Some(Verdict::Ok));
        assert_eq!(verdict(&bound(&[(Verdict::Ok, 900), (Verdict::Limited, 100)])), Some(Verdict::Limited));
        assert_eq!(verdict(&bound(&[])), None);
    }

    #[test]
    fn unrelated_clocks_have_no_bound() {
        let cell = ClockCell::of(PlacementKind::Remote, &[bound(&[(Verdict::Unsynchronised, 300)])]);
        assert_eq!(cell.bound, None);
        assert_eq!(cell.chip.map(|chip| chip.word), Some("unsynchronised"));
        assert!(cell.title.contains("nothing related"));
    }

    #[test]
    fn cell_without_delays_states_the_reason() {
        assert_eq!(ClockCell::of(PlacementKind::Local, &[]).words, "one host");
        assert_eq!(ClockCell::of(PlacementKind::Remote, &[]).words, "no delays");
    }
}
