//! Judgement of restarts: successful iterations that waited for a process that had died before them.

use peernet_statistics::number::fixed;
use peernet_stream::Grade;

use super::{finding, iterations, ms, percent, with_advice};
use crate::trust::{Finding, Restarts, TrustInput};

/// Share of the sum of all totals that restarts may take; equal to the limit for outliers in the mean.
const MAX_INFLUENCE: f64 = 0.05;
/// Maximum number of iterations that are named.
const MAX_NAMED: usize = 5;

/// Returns one finding for each process that was restarted.
pub(super) fn findings(input: &TrustInput) -> Vec<Finding> {
    let all = input.total.as_ref().map_or(0.0, |total| total.mean * input.counts.ok as f64);
    let of = |restarts: &Restarts| {
        let share = if all > 0.0 { restarts.seconds / all } else { 0.0 };
        let text = format!(
            "The {}'s process was restarted in {}{}, which waited {} for it: {} of the sum of all totals.",
            restarts.owner,
            iterations(restarts.count),
            named(&restarts.iterations),
            ms(restarts.seconds),
            percent(share)
        );
        let advice = "leave these iterations out (in data.csv a column whose name ends in `restart` has a number), or give the \
                      median; the failed one before each says what the process died of";
        let grade = if share < MAX_INFLUENCE { Grade::Good } else { Grade::Doubtful };
        with_advice(finding("restarts", grade, text), advice)
    };
    input.restarts.iter().map(of).collect()
}

/// Returns ` (numbers 9, 14)`; empty if the numbers are not known.
fn named(numbers: &[u64]) -> String {
    if numbers.is_empty() {
        return String::new();
    }
    let mut named: Vec<String> =
        numbers.iter().take(MAX_NAMED).map(|number| fixed(*number as f64, 0)).collect();
    if numbers.len() > MAX_NAMED {
        named.push("…".to_owned());
    }
    format!(" (number{} {})", if numbers.len() == 1 { "" } else { "s" }, named.join(", "))
}
