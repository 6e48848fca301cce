//! Counts the requests of each run that arrived here.
//!
//! After a lost connection a run continues in another session. An edge's goodbye says how many iterations the run was
//! to have, so that a server of a fixed number of answers need not wait for those that never come.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use peernet_logger::{HostId, Slug};

/// Number of runs above which those of edges without a session are forgotten. They are kept for when the edge comes
/// back.
const MAX_RUNS: usize = 256;

/// Requests of the current run of each pipeline.
#[derive(Debug, Default)]
pub(super) struct RequestCounts(HashMap<(HostId, Slug), Arc<AtomicU64>>);

impl RequestCounts {
    /// Returns the counter of the requests of a new session.
    pub(super) fn by(&mut self, host: HostId, pipeline: &Slug) -> Arc<AtomicU64> {
        if self.0.len() >= MAX_RUNS {
            self.0.retain(|_, count| Arc::strong_count(count) > 1);
        }
        Arc::clone(self.0.entry((host, pipeline.clone())).or_default())
    }

    /// Handles an edge's goodbye. Returns how many of the run's planned iterations never arrived, if the run is over.
    pub(super) fn missed(&mut self, host: HostId, pipeline: &Slug, ordered: Option<u64>) -> u64 {
        let came = self.0.remove(&(host, pipeline.clone())).map_or(0, |count| count.load(Ordering::Relaxed));
        ordered.map_or(0, |ordered| ordered.saturating_sub(came))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_counted_over_sessions_and_forgotten_eventually() {
        let (mut request_counts, host, line) =
            (RequestCounts::default(), HostId::random(), "line".parse().expect("a name"));
        for _ in 0..2 {
            request_counts.by(host, &line).fetch_add(20, Ordering::Relaxed);
        }
        assert_eq!(
            (request_counts.missed(host, &line, Some(41)), request_counts.missed(host, &line, Some(9))),
            (1, 9)
        );
        request_counts.by(host, &line).fetch_add(5, Ordering::Relaxed);
        assert_eq!(request_counts.missed(host, &line, None), 0, "it was stopped");
        assert_eq!(request_counts.missed(host, &line, Some(5)), 5, "and begins anew");
        let open = request_counts.by(host, &line);
        open.fetch_add(3, Ordering::Relaxed);
        for _ in 0..2 * MAX_RUNS {
            request_counts.by(HostId::random(), &line);
        }
        assert!(request_counts.0.len() <= MAX_RUNS);
        assert_eq!(request_counts.missed(host, &line, Some(4)), 1);
    }
}
