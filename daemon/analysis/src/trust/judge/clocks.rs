//! Judgement of the one-way delays. The total latency does not depend on these delays, because it is measured on the
//! edge alone.

use peernet_clock::Verdict;
use peernet_statistics::number::{ends_ms, is_exact, milliseconds, within_ms};
use peernet_stream::Grade;

use super::{finding, percent, with_advice};
use crate::delays::ClockInterval;
use crate::trust::{DelayQuality, Finding, TrustInput};

/// If at least this share of the delays has no value, the finding is bad.
const MAJORITY_SHARE: f64 = 0.5;

/// Returns a finding for each direction that has judged delays.
pub(super) fn findings(input: &TrustInput) -> Vec<Finding> {
    input.clocks.iter().filter_map(judge_direction).collect()
}

fn judge_direction(clocks: &DelayQuality) -> Option<Finding> {
    let stage = &clocks.stage;
    let about = format!("clocks, {stage}");
    // Pages choose the verdict that they show beside these delays by the same rule.
    let summary_verdict = Verdict::summarise(clocks.verdicts.iter().copied())?;
    let total: u64 = clocks.verdicts.iter().map(|(_, count)| count).sum();
    let verdict_shares: Vec<String> = clocks
        .verdicts
        .iter()
        .filter(|(_, count)| *count > 0)
        .map(|(verdict, count)| format!("{verdict} {}", percent(*count as f64 / total as f64)))
        .collect();
    let precision = match (clocks.delay, clocks.interval) {
        (Some(delay), Some(ClockInterval { lo, hi, .. })) if is_exact(hi - lo) => {
            format!("the median of {}\u{202f}ms is exact: both ends read one clock", milliseconds(delay))
        }
        (Some(delay), Some(ClockInterval { lo, hi, method })) => {
            let remark = method.remark().map_or_else(String::new, |remark| format!(" ({remark})"));
            format!(
                "the median of {}\u{202f}ms lies between {}\u{202f}ms{remark}",
                within_ms(delay, (lo, hi)),
                ends_ms(lo, hi).join(" and ")
            )
        }
        (Some(delay), None) => {
            format!(
                "the median of {}\u{202f}ms has no bounds, because some delays have none",
                milliseconds(delay)
            )
        }
        (None, _) => "no delay has a value".to_owned(),
    };
    let text = format!("Of the delays of `{stage}`, {}; {precision}.", verdict_shares.join(", "));
    let unusable_verdicts = [Verdict::Unsynchronised, Verdict::Stepped, Verdict::Inconsistent];
    let unusable = clocks.verdicts.iter().filter(|(verdict, _)| unusable_verdicts.contains(verdict));
    let unusable: u64 = unusable.map(|(_, count)| count).sum();
    Some(match summary_verdict {
        Verdict::Ok => finding(&about, Grade::Good, text),
        Verdict::Limited => with_advice(
            finding(&about, Grade::Doubtful, text),
            "the interval is wider than half the delay, or a jump of a clock was suspected: publish the interval, or the sum of \
             upload and download",
        ),
        Verdict::Stale => with_advice(
            finding(&about, Grade::Doubtful, text),
            "the two clocks were rarely compared, or exchanges contradicted each other: check that the probes' port is open, \
             exchange samples more often, and see the incidents of the link",
        ),
        _ if unusable as f64 >= MAJORITY_SHARE * total as f64 => with_advice(
            finding(&about, Grade::Bad, text),
            "do not publish upload and download separately: their sum and the total need no related clocks; \
             `peernet calibrate` shows the cause",
        ),
        Verdict::Unsynchronised | Verdict::Stepped | Verdict::Inconsistent => with_advice(
            finding(&about, Grade::Doubtful, text),
            "delays without a value are in no statistic: report this, or repeat the run when the clocks are stable",
        ),
    })
}
