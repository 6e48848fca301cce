//! Judgement of latencies that were not measured but drawn from a distribution.

use peernet_stream::Grade;

use super::{finding, ms, percent, with_advice};
use crate::trust::{Finding, TrustInput};

/// A finding reports the mean overrun if it is at least this share of the mean total.
const NOTABLE_OVERRUN_SHARE: f64 = 0.01;
/// If the mean overrun is at least this share of the mean total, the finding is bad: the latencies are then those of
/// the model's host rather than those of the distribution.
const BAD_OVERRUN_SHARE: f64 = 0.1;

/// Returns the findings about drawn latencies; empty if the latencies of the model are measured.
pub(super) fn findings(input: &TrustInput) -> Vec<Finding> {
    let Some(replayed) = input.replayed_latencies() else { return Vec::new() };
    let replayed = replayed.describe();
    let text = format!("The latencies of the model are replayed, not measured: {replayed}.");
    let advice = "mark the results as replayed where they are published; they are estimates for a machine, not measurements of it";
    let mut all = vec![with_advice(finding("replayed", Grade::Doubtful, text), advice)];
    all.extend(judge_overrun(input));
    all
}

fn judge_overrun(input: &TrustInput) -> Option<Finding> {
    let overrun = input.overrun?;
    let share = overrun / input.total.as_ref()?.mean;
    let grade = match share {
        share if share >= BAD_OVERRUN_SHARE => Grade::Bad,
        share if share >= NOTABLE_OVERRUN_SHARE => Grade::Doubtful,
        _ => return None,
    };
    let text = format!(
        "Inference took longer than the replayed latencies, by {} on average, {} of the total: the inner model is slower than \
         the drawn latencies, or the host of the model was busy.",
        ms(overrun),
        percent(share)
    );
    let advice = "name a faster model as `inner`, or no `inner` model, and stop other programs on the host of the model";
    Some(with_advice(finding("overrun", grade, text), advice))
}
