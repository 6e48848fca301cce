//! Outcomes of iterations.

use peernet_stream::OutcomeCounts;

/// Returns the share of iterations without an answer, 0 to 1; `None` without iterations.
pub fn unanswered_share(counts: &OutcomeCounts) -> Option<f64> {
    let total = counts.total();
    (total > 0).then(|| (total - counts.ok) as f64 / total as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failed_lost_and_late_iterations_have_no_answer() {
        let counts = OutcomeCounts { ok: 15, failed: 1, lost: 2, timeout: 2 };
        assert_eq!(unanswered_share(&counts), Some(0.25));
        assert_eq!(unanswered_share(&OutcomeCounts::default()), None);
    }
}
