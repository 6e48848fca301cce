//! Counts the requests of each run over all of its sessions.
//!
//! After a lost connection a run continues in another session. An edge's goodbye contains the planned number of
//! iterations. With this number, a server that ends after a fixed number of answers does not wait for requests that
//! never arrive.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use peernet_logger::{HostId, Slug};

/// Number of counters from which on the counters of edges without a session are removed. Below this number they are
/// kept, because the edge may reconnect.
const MAX_RUNS: usize = 256;

/// Requests of the current run of each pipeline.
#[derive(Debug, Default)]
pub(super) struct RequestCounts(HashMap<(HostId, Slug), Arc<AtomicU64>>);

impl RequestCounts {
    /// Returns the counter for the requests of a new session: the counter of the pipeline's current run.
    pub(super) fn counter(&mut self, host: HostId, pipeline: &Slug) -> Arc<AtomicU64> {
        if self.0.len() >= MAX_RUNS {
            // A session holds a clone of its counter.
            self.0.retain(|_, count| Arc::strong_count(count) > 1);
        }
        Arc::clone(self.0.entry((host, pipeline.clone())).or_default())
    }

    /// Handles an edge's goodbye. Returns the number of the run's planned iterations whose requests never arrived; 0 if
    /// the run is not over (`planned_iterations` is `None`).
    pub(super) fn take_missed(
        &mut self,
        host: HostId,
        pipeline: &Slug,
        planned_iterations: Option<u64>,
    ) -> u64 {
        let requests =
            self.0.remove(&(host, pipeline.clone())).map_or(0, |count| count.load(Ordering::Relaxed));
        planned_iterations.map_or(0, |planned_iterations| planned_iterations.saturating_sub(requests))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_counted_over_sessions_in_bounded_memory() {
        let (mut request_counts, host, pipeline) =
            (RequestCounts::default(), HostId::random(), "arm".parse().expect("a name"));
        for _ in 0..2 {
            request_counts.counter(host, &pipeline).fetch_add(20, Ordering::Relaxed);
        }
        assert_eq!(
            (
                request_counts.take_missed(host, &pipeline, Some(41)),
                request_counts.take_missed(host, &pipeline, Some(9))
            ),
            (1, 9),
            "the first goodbye removes the count"
        );
        request_counts.counter(host, &pipeline).fetch_add(5, Ordering::Relaxed);
        assert_eq!(request_counts.take_missed(host, &pipeline, None), 0, "the run is not over");
        assert_eq!(request_counts.take_missed(host, &pipeline, Some(5)), 5, "the count was reset");
        let counter_in_use = request_counts.counter(host, &pipeline);
        counter_in_use.fetch_add(3, Ordering::Relaxed);
        for _ in 0..2 * MAX_RUNS {
            request_counts.counter(HostId::random(), &pipeline);
        }
        assert!(request_counts.0.len() <= MAX_RUNS);
        assert_eq!(request_counts.take_missed(host, &pipeline, Some(4)), 1, "a counter in use is kept");
    }
}
