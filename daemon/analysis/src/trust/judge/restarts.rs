//! Judgement of restarts: answered iterations that waited for the restart of a process that had died in an earlier
//! iteration.

use peernet_statistics::number;
use peernet_stream::Grade;

use super::time_series::MAX_INFLUENCE;
use super::{finding, iterations, ms, percent, with_advice};
use crate::trust::{Finding, Restarts, TrustInput};

/// Maximum number of iterations whose numbers a finding lists.
const MAX_LISTED: usize = 5;

/// Returns one finding for each process that was restarted.
pub(super) fn findings(input: &TrustInput) -> Vec<Finding> {
    let total_seconds = input.total.as_ref().map_or(0.0, |total| total.mean * input.counts.ok as f64);
    let judge = |restarts: &Restarts| {
        let share = if total_seconds > 0.0 { restarts.seconds / total_seconds } else { 0.0 };
        let text = format!(
            "The {}'s process was restarted in {}{}. The waits for the restarts took {} in all, {} of the time of all iterations.",
            restarts.owner,
            iterations(restarts.count),
            list_of_numbers(&restarts.iterations),
            ms(restarts.seconds),
            percent(share)
        );
        let advice = "leave these iterations out (in data.csv, their rows have a number in a column whose name ends in `restart`), or publish the \
                      median; the failed iteration before each restart has the reason";
        let grade = if share < MAX_INFLUENCE { Grade::Good } else { Grade::Doubtful };
        with_advice(finding("restarts", grade, text), advice)
    };
    input.restarts.iter().map(judge).collect()
}

/// Returns ` (numbers 9, 14)`; empty if the numbers are not known.
fn list_of_numbers(numbers: &[u64]) -> String {
    if numbers.is_empty() {
        return String::new();
    }
    let mut texts: Vec<String> =
        numbers.iter().take(MAX_LISTED).map(|number| number::count(*number)).collect();
    if numbers.len() > MAX_LISTED {
        texts.push("…".to_owned());
    }
    format!(" (number{} {})", if numbers.len() == 1 { "" } else { "s" }, texts.join(", "))
}
