//! Runs with episodes.

use peernet_logger::RunId;
use peernet_stream::{Event, ExperimentPosition, Outcome};

use super::TestSite;

impl TestSite {
    /// Stores an experiment with a run of each pipeline, in episodes of `steps` steps. The first episode is warm-up,
    /// and every hundredth iteration times out.
    pub(crate) async fn store_episodes(&mut self, iterations: u64, steps: u32) {
        let id = RunId::random().to_string();
        for index in 0..self.pipelines.len() {
            let configuration = vec![("picture".to_owned(), self.pipelines[index].name.to_owned())];
            let position = ExperimentPosition {
                name: "tasks".to_owned(),
                id: id.clone(),
                configuration,
                repeat: 0,
                ..ExperimentPosition::default()
            };
            let mut events = self.run(index, RunId::random(), iterations, Some(position));
            for event in &mut events {
                if let Event::Iteration(iteration) = event {
                    let before = iteration.number - 1;
                    iteration.episode = (before / u64::from(steps)) as u32;
                    iteration.step = (before % u64::from(steps)) as u32;
                    iteration.warm_up = iteration.episode == 0;
                    if iteration.number.is_multiple_of(100) {
                        iteration.outcome = Outcome::Timeout(String::new());
                    }
                }
            }
            self.agents[index].offer(events);
            self.agents[index].wait_until_stored().await;
        }
    }
}
