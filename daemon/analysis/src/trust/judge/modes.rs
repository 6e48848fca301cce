//! Judgement of distributions with two modes. Mean and standard deviation do not describe such distributions.

use peernet_statistics::TwoModes;
use peernet_statistics::number::fixed;
use peernet_stream::Grade;

use super::{finding, ms, percent, with_advice};
use crate::total_column::TotalColumn;
use crate::trust::{Finding, TrustInput};

/// Returns a finding for each distribution with two modes.
pub(super) fn findings(input: &TrustInput) -> Vec<Finding> {
    input.two_modes.iter().map(|(name, modes)| judge(name, modes)).collect()
}

fn judge(name: &str, TwoModes { medians, upper_share }: &TwoModes) -> Finding {
    let is_time = TotalColumn::Measured.latency_names().iter().any(|time| time == name);
    let quantity = |value: f64| if is_time { ms(value) } else { fixed(value, 0) };
    let (lower, upper) = (quantity(medians.0), quantity(medians.1));
    let text = format!(
        "The values of `{name}` have two modes: {} of them lie around {lower}, {} around {upper}. Their mean and standard \
         deviation describe neither.",
        percent(1.0 - upper_share),
        percent(*upper_share)
    );
    let advice = if is_time {
        "report the two groups, or median, 95th and 99th percentile, and find what separates them: a network path, a cache, \
         two kinds of samples, or a change during the run"
    } else {
        "report the two groups of answers, or latency per token, and find what separates them: two kinds of questions, or a \
         limit on the number of tokens"
    };
    with_advice(finding("two modes", Grade::Doubtful, text), advice)
}
