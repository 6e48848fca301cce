//! Outcomes of iterations.

use peernet_statistics::number::count;
use peernet_stream::OutcomeCounts;

/// Returns the share of failed iterations, of any outcome but `ok`, 0 to 1; `None` without iterations.
pub fn failed_share(counts: &OutcomeCounts) -> Option<f64> {
    let total = counts.total();
    (total > 0).then(|| (total - counts.ok) as f64 / total as f64)
}

/// Returns the number of failed iterations of each outcome with its name, such as `2 lost`; empty if no iteration failed.
pub fn failed_texts(counts: &OutcomeCounts) -> Vec<String> {
    let outcomes = [
        (counts.failed, "with an error of sensor, model or actuator"),
        (counts.lost, "lost"),
        (counts.timeout, "timed out"),
    ];
    let occurred = outcomes.into_iter().filter(|(number, _)| *number > 0);
    occurred.map(|(number, outcome)| format!("{} {outcome}", count(number))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_losses_and_timeouts_are_failed() {
        let counts = OutcomeCounts { ok: 15, failed: 1, lost: 2, timeout: 2 };
        assert_eq!(failed_share(&counts), Some(0.25));
        assert_eq!(failed_share(&OutcomeCounts::default()), None);
        let texts = ["1 with an error of sensor, model or actuator", "2 lost", "2 timed out"];
        assert_eq!(failed_texts(&counts), texts);
        assert!(failed_texts(&OutcomeCounts { ok: 3, ..OutcomeCounts::default() }).is_empty());
    }
}
