//! Judgement of the one-way delays. The total does not depend on them, because it is measured on the edge alone.

use peernet_clock::Verdict;
use peernet_statistics::number::{bound_ms, milliseconds};
use peernet_stream::Grade;

use super::{finding, percent, with_advice};
use crate::trust::{Clocks, Finding, TrustInput};

/// If at least this share of the delays is unusable, the grade is bad. If at least this share is limited, the grade is doubtful.
const MAJORITY_SHARE: f64 = 0.5;
/// Up to this share, unusable or stale delays do not affect the grade, because so few delays do not change a median.
const NEGLIGIBLE_SHARE: f64 = 0.01;

pub(super) fn findings(input: &TrustInput) -> Vec<Finding> {
    input.clocks.iter().filter_map(judge_direction).collect()
}

fn judge_direction(clocks: &Clocks) -> Option<Finding> {
    let stage = &clocks.stage;
    let about = format!("clocks, {stage}");
    let total: u64 = clocks.verdicts.iter().map(|(_, count)| count).sum();
    if total == 0 {
        return None;
    }
    let share = |wanted: &[Verdict]| {
        let count: u64 = clocks
            .verdicts
            .iter()
            .filter(|(verdict, _)| wanted.contains(verdict))
            .map(|(_, count)| count)
            .sum();
        count as f64 / total as f64
    };
    let verdict_shares: Vec<String> = clocks
        .verdicts
        .iter()
        .filter(|(_, count)| *count > 0)
        .map(|(verdict, count)| format!("{verdict} {}", percent(*count as f64 / total as f64)))
        .collect();
    let precision = match (clocks.delay, clocks.half_width) {
        (Some(delay), Some(0.0)) => {
            format!("the median of {}\u{202f}ms is exact: both ends read one clock", milliseconds(delay))
        }
        (Some(delay), Some(half_width)) => {
            format!(
                "the median of {}\u{202f}ms is known to {}\u{202f}ms",
                milliseconds(delay),
                bound_ms(half_width)
            )
        }
        _ => "no delay has a value".to_owned(),
    };
    let text = format!("Of the delays of `{stage}`, {}; {precision}.", verdict_shares.join(", "));
    let unusable = share(&[Verdict::Unsynchronised, Verdict::Stepped, Verdict::Inconsistent]);
    let (limited, stale) = (share(&[Verdict::Limited]), share(&[Verdict::Stale]));
    Some(match () {
        () if unusable >= MAJORITY_SHARE => with_advice(
            finding(&about, Grade::Bad, text),
            "do not publish upload and download separately: their sum and the total need no related clocks; \
             `peernet calibrate` shows the cause",
        ),
        () if unusable > NEGLIGIBLE_SHARE => with_advice(
            finding(&about, Grade::Doubtful, text),
            "delays without a value are in no statistic: report this, or repeat the run when the clocks are stable",
        ),
        () if limited >= MAJORITY_SHARE => with_advice(
            finding(&about, Grade::Doubtful, text),
            "the interval is wider than half the delay: publish the interval, or the sum of upload and download",
        ),
        () if stale > NEGLIGIBLE_SHARE => with_advice(
            finding(&about, Grade::Doubtful, text),
            "the two clocks were rarely compared: check that the probes' port is open, or exchange samples more often",
        ),
        () => finding(&about, Grade::Good, text),
    })
}
