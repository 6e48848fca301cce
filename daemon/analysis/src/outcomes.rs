//! Outcomes of iterations.

use peernet_stream::OutcomeCounts;

/// Returns the share of failed iterations, of any outcome but `ok`, 0 to 1; `None` without iterations.
pub fn failed_share(counts: &OutcomeCounts) -> Option<f64> {
    let total = counts.total();
    (total > 0).then(|| (total - counts.ok) as f64 / total as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_losses_and_timeouts_are_failed() {
        let counts = OutcomeCounts { ok: 15, failed: 1, lost: 2, timeout: 2 };
        assert_eq!(failed_share(&counts), Some(0.25));
        assert_eq!(failed_share(&OutcomeCounts::default()), None);
    }
}
