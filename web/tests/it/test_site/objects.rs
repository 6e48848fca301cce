//! A pipeline that logs a value for each object in a picture.

use peernet_clock::Span;
use peernet_logger::{Measure, NodeId, RunId};
use peernet_stream::Event;

use super::TestSite;

impl TestSite {
    /// Stores a run of a pipeline in which each iteration has two nodes of the name `crop`.
    pub(crate) async fn store_crops(&mut self, index: usize, iterations: u64) {
        let mut events = self.run(index, RunId::random(), iterations, true, None);
        for event in &mut events {
            if let Event::Iteration(iteration) = event {
                for millis in [1, 2] {
                    let measure = Measure::Timer(Some(Span::from_millis(millis)));
                    iteration.tree.add(NodeId::ROOT, "crop".into(), Span::ZERO, measure);
                }
            }
        }
        self.agents[index].offer(events);
        self.agents[index].wait_until_stored().await;
    }
}
