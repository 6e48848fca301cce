//! A pipeline that is too slow for its rate.

use peernet_clock::Span;
use peernet_logger::{Measure, NodeId, RunId, Unit};
use peernet_stream::{Event, Outcome};

use super::TestSite;

impl TestSite {
    /// Stores a run of a pipeline; the first [`WARM_UP_ITERATIONS`](super::WARM_UP_ITERATIONS) are the warm-up. Every
    /// tenth iteration times out, and `skipped_before_timeout` starts are skipped before it. Each iteration has two nodes
    /// with the name `crop`, as for two objects in a picture.
    pub(crate) async fn store_overloaded_run(
        &mut self,
        index: usize,
        iterations: u64,
        skipped_before_timeout: u32,
    ) {
        let mut events = self.run(index, RunId::random(), iterations, None);
        for event in &mut events {
            let Event::Iteration(iteration) = event else { continue };
            for millis in [1, 2] {
                let measure = Measure::Timer(Some(Span::from_millis(millis)));
                iteration.tree.add(NodeId::ROOT, "crop".into(), Span::ZERO, measure);
            }
            if iteration.number.is_multiple_of(10) {
                let measure = Measure::Value(skipped_before_timeout.into(), Unit::NONE);
                iteration.tree.add(NodeId::ROOT, "skipped-starts".into(), Span::ZERO, measure);
                iteration.outcome = Outcome::Timeout(String::new());
            }
        }
        self.agents[index].offer(events);
        self.agents[index].wait_until_stored().await;
    }
}
