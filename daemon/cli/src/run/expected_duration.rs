//! Expected duration of a run, from its configuration.

use std::num::NonZeroU64;

use peernet_agent::config::{AgentConfig, PipelineConfig, PlacementConfig};
use peernet_analysis::pace::Pace;

/// Users that share the workers of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct SharedComputation {
    /// Number of users: edges that send samples to the model at the same time.
    users: u32,
    /// Number of samples that the model computes at the same time.
    workers: usize,
}

impl SharedComputation {
    /// Returns how users and workers share the model of the agent's first pipeline. A local model has a separate
    /// process for each user. The number of workers of a cloud is unknown here; the default is one.
    fn new(agent: &AgentConfig, users: u32) -> Self {
        let Some(PlacementConfig::Local { model }) =
            agent.pipelines.first().map(|pipeline| &pipeline.placement)
        else {
            return Self { users: users.max(1), workers: 1 };
        };
        let configured = agent.models.iter().find(|configured_model| configured_model.name() == model);
        Self {
            users: 1,
            workers: configured
                .map_or(agent.bank.workers.get(), |configured_model| configured_model.workers()),
        }
    }
}

/// Returns the expected duration of a run of an agent's first pipeline with this number of users, seconds; `None` if
/// unknown.
pub(super) fn expected_duration(agent: &AgentConfig, users: u32, pace: Option<Pace>) -> Option<f64> {
    pipeline_duration(agent.pipelines.first()?, SharedComputation::new(agent, users), pace)
}

fn pipeline_duration(
    pipeline: &PipelineConfig,
    sharing: SharedComputation,
    pace: Option<Pace>,
) -> Option<f64> {
    let configured_period_s = pipeline.load.hz().map(f64::recip);
    // No schedule makes the sensor or the model's workers faster: starts beyond their rate are skipped and do not
    // count.
    let shortest_period_s = |pace: Pace| {
        let computing_s = pace.computing_s * f64::from(sharing.users) / sharing.workers as f64;
        pace.sensing_s.max(computing_s)
    };
    let iteration_s = match (configured_period_s, pace) {
        (Some(period_s), Some(pace)) => {
            let in_flight = pipeline.max_in_flight.get() as f64;
            Some(period_s.max(pace.iteration_s / in_flight).max(shortest_period_s(pace)))
        }
        (Some(period_s), None) => Some(period_s),
        (None, pace) => pace.map(|pace| pace.iteration_s.max(shortest_period_s(pace))),
    };
    let by_count =
        pipeline.total_iterations().zip(iteration_s).map(|(count, iteration_s)| count as f64 * iteration_s);
    let by_time = pipeline.limit.duration_s.zip(pipeline.iterations_until_measured(NonZeroU64::MIN));
    let by_time =
        by_time.map(|(seconds, first)| seconds + (first - 1) as f64 * iteration_s.unwrap_or_default());
    let measuring = [by_count, by_time].into_iter().flatten().reduce(f64::min)?;
    Some(measuring + pace.map_or(0.0, |pace| pace.overhead_s))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pipeline(more: &str) -> PipelineConfig {
        toml::from_str(&format!(
            "name = 'p'\nsensor = {{ kind = 'synthetic', size_bytes = 1 }}\nplacement = {{ kind = 'none' }}\n{more}"
        ))
        .expect("a pipeline")
    }

    #[test]
    fn estimate_follows_from_limit_and_pace() {
        let alone = SharedComputation { users: 1, workers: 1 };
        let expected_duration =
            |pipeline: &PipelineConfig, pace: Option<Pace>| pipeline_duration(pipeline, alone, pace);
        let pace = Some(Pace { iteration_s: 0.1, overhead_s: 2.0, sensing_s: 0.01, computing_s: 0.05 });
        let closed = pipeline("limit = { total = 100 }");
        assert_eq!((expected_duration(&closed, pace), expected_duration(&closed, None)), (Some(12.0), None));
        let counted = pipeline("limit = { iterations = 100 }\nwarm_up = { iterations = 5 }");
        assert_eq!(expected_duration(&counted, pace), Some(12.5));
        let episodes = pipeline(
            "limit = { iterations = 90 }\nepisode_steps = 10\nwarm_up = { iterations = 0, steps = 1 }",
        );
        assert_eq!(expected_duration(&episodes, pace), Some(12.0));
        let rate = pipeline("limit = { total = 100 }\nload = { mode = 'rate', hz = 5.0 }");
        assert_eq!(
            (expected_duration(&rate, pace), expected_duration(&rate, None)),
            (Some(22.0), Some(20.0))
        );
        let time = pipeline("limit = { total = 1000, duration_s = 3.0 }");
        // The duration is 3 s and follows the five iterations of the default warm-up.
        assert_eq!(expected_duration(&time, pace), Some(5.5));
    }

    #[test]
    fn overloaded_run_takes_as_long_as_its_model() {
        let pace = Some(Pace { iteration_s: 0.11, overhead_s: 0.0, sensing_s: 0.001, computing_s: 0.125 });
        let rate =
            pipeline("limit = { total = 100 }\nload = { mode = 'rate', hz = 100.0 }\nmax_in_flight = 8");
        let duration = |users, workers| pipeline_duration(&rate, SharedComputation { users, workers }, pace);
        assert_eq!([duration(1, 1), duration(1, 2), duration(3, 1)], [Some(12.5), Some(6.25), Some(37.5)]);
        let slow_sensor =
            Some(Pace { iteration_s: 0.11, overhead_s: 0.0, sensing_s: 0.05, computing_s: 0.0 });
        assert_eq!(
            pipeline_duration(&rate, SharedComputation { users: 1, workers: 1 }, slow_sensor),
            Some(5.0)
        );
    }
}
