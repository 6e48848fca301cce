//! Tests of episodes: reset, early end by the feedback of the actuator, success and return.

use peernet_stream::{Iteration, Outcome, PipelineState};

use crate::harness::{Aggregator, TestAgent, assert_adds_up, value};

/// Sensors and actuators of the tests. With `Arm`, every other episode succeeds in its third step. The second reset of
/// `FailingReset` fails. `AdvanceReporter` reports the latest advance of `Simulation` as reward.
const SYSTEM: &str = "
class Sensor:
    def __init__(self): self.episode, self.step = 0, 0
    def reset(self): self.episode, self.step = self.episode + 1, 0
    def sample(self):
        assert self.episode, 'sampled before a reset'
        self.step += 1
        return {'episode': self.episode, 'step': self.step}

class Arm:
    def __init__(self): self.episode = 0
    def reset(self): self.episode += 1
    def act(self, answer):
        assert answer['episode'] == self.episode, 'an answer of another episode'
        ended = self.episode % 2 == 0 and answer['step'] >= 3
        return {'episode_ended': ended, 'success': ended, 'reward': 0.5}

class FailingReset(Sensor):
    def reset(self):
        super().reset()
        if self.episode == 2: raise RuntimeError('no arm')

class Simulation(Sensor):
    def __init__(self):
        super().__init__()
        self.advances = []
    def reset(self):
        super().reset()
        self.advances = []
    def advance(self, seconds):
        import time
        if self.episode == 3 and self.step == 2: raise RuntimeError('unstable')
        time.sleep(0.05)
        self.advances.append(seconds)
    def sample(self):
        return dict(super().sample(), advances=self.advances)

class AdvanceReporter:
    def act(self, answer):
        assert len(answer['advances']) == answer['step'] - 1, answer
        if answer['advances']: return {'reward': answer['advances'][-1]}

class Camera:
    def sample(self): return {'episode': 1}

class CountingCamera:
    def __init__(self): self.resets = 0
    def reset(self): self.resets += 1
    def sample(self): return {'episode': self.resets}

class Gripper:
    def act(self, answer): return {'reward': answer['episode']}

class CountingGripper:
    def __init__(self): self.resets = 0
    def reset(self): self.resets += 1
    def act(self, answer): return {'reward': answer['episode'] * 10 + self.resets}

class Stuck(Arm):
    def act(self, answer):
        import time
        if answer['step'] == 2: time.sleep(100)
        return {'success': True, 'reward': 1}
";

/// Runs a pipeline to the end of its run, and returns its iterations in their order.
async fn run(model: &str, (sensor, actuator): (&str, &str), keys: &str) -> Vec<Iteration> {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("own.py"), SYSTEM).expect("can be written");
    let object = |name: &str, keys: &str| {
        format!("{{ kind = 'python', object = 'own::{name}', folder = '{}'{keys} }}", folder.path().display())
    };
    let tables = format!(
        "[[model]]\nname = 'policy'\n{model}\n\
         [[pipeline]]\nname = 'line'\nsensor = {}\nactuator = {}\n\
         placement = {{ kind = 'local', model = 'policy' }}\n{keys}",
        object(sensor, ""),
        object(actuator, ", timeout_ms = 300"),
    );
    let aggregator = Aggregator::start().await;
    let agent = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_eq!(agent.until_state(|state| *state != PipelineState::Running).await, PipelineState::Finished);
    let facts = &received_events.run_starts()[0].facts;
    assert!(facts.iter().any(|(name, text)| name == "Actuator" && text.contains("own::")), "{facts:?}");
    let mut iterations: Vec<Iteration> = received_events.iterations().into_iter().cloned().collect();
    iterations.sort_by_key(|iteration| iteration.number);
    agent.stop().await.expect("stops well");
    iterations
}

/// Returns episode and step of each iteration.
fn positions(iterations: &[Iteration]) -> Vec<(u32, u32)> {
    iterations.iter().map(|iteration| (iteration.episode, iteration.step)).collect()
}

/// Returns episode, success and return of each iteration with which an episode ended.
fn results(iterations: &[Iteration]) -> Vec<(u32, f64, f64)> {
    let result = |iteration: &Iteration| {
        let success = value(&iteration.tree, "episode-success")?;
        Some((iteration.episode, success, value(&iteration.tree, "episode-return")?))
    };
    iterations.iter().filter_map(result).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn feedback_ends_episodes_and_gives_results() {
    let keys =
        "episode_steps = 5\nlimit = { episodes = 4 }\nwarm_up = { iterations = 0, episodes = 1, steps = 1 }";
    let iterations = run("kind = 'echo'", ("Sensor", "Arm"), keys).await;
    let steps = |episode, steps: u32| (0..steps).map(move |step| (episode, step));
    let expected: Vec<_> = steps(0, 5).chain(steps(1, 3)).chain(steps(2, 5)).chain(steps(3, 3)).collect();
    assert_eq!(positions(&iterations), expected);
    for iteration in &iterations {
        assert_eq!(iteration.outcome, Outcome::Ok);
        assert_adds_up(iteration);
        assert_eq!(iteration.warm_up, iteration.episode == 0 || iteration.step == 0);
        assert_eq!(value(&iteration.tree, "reward"), Some(0.5));
        let ended = iteration.episode % 2 == 1 && iteration.step == 2;
        assert_eq!(value(&iteration.tree, "success"), Some(if ended { 1.0 } else { 0.0 }));
        assert_eq!(value(&iteration.tree, "episode-ended"), ended.then_some(1.0));
        assert!(iteration.tree.find(&["actuation", "actuation-ipc"]).is_some());
    }
    assert_eq!(results(&iterations), [(1, 1.0, 1.5), (2, 0.0, 2.5), (3, 1.0, 1.5)], "episode 0 is warm-up");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn reset_waits_for_iterations_in_flight() {
    let keys = "episode_steps = 12\nlimit = { episodes = 4 }\nwarm_up = { iterations = 0 }\n\
                load = { mode = 'rate', hz = 100.0 }\nmax_in_flight = 4";
    let model = "kind = 'exec'\nworkers = 4\ncommand = '''while read -r word bytes media shape rest; do \
                 x=$(head -c \"$bytes\"); sleep 0.05; printf \"answer %d $media\\n%s\" \"$bytes\" \"$x\"; done'''";
    let iterations = run(model, ("Sensor", "Arm"), keys).await;
    // The actuator fails if it gets the answer to a sample of an episode for which it was not reset.
    assert!(iterations.iter().all(|iteration| iteration.outcome == Outcome::Ok), "{iterations:#?}");
    let all = positions(&iterations);
    assert!(all.is_sorted_by(|a, b| a < b) && all.contains(&(0, 11)) && all.contains(&(2, 11)), "{all:?}");
    let episodes: Vec<_> =
        results(&iterations).iter().map(|(episode, success, _)| (*episode, *success)).collect();
    assert_eq!(episodes, [(0, 0.0), (1, 1.0), (2, 0.0), (3, 1.0)]);
    // The third action ends episode 1. Samples that were taken before still belong to episode 1, and their answers are
    // not acted on.
    let superseded = |iteration: &&Iteration| value(&iteration.tree, "superseded") == Some(1.0);
    let not_acted_on: Vec<_> =
        iterations.iter().filter(superseded).filter(|iteration| iteration.episode == 1).collect();
    assert!(not_acted_on.iter().any(|iteration| iteration.step > 2), "{all:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn failed_reset_fails_one_iteration_and_its_episode() {
    let keys = "episode_steps = 3\nlimit = { episodes = 3 }\nwarm_up = { iterations = 0, steps = 1 }";
    let iterations = run("kind = 'echo'", ("FailingReset", "Arm"), keys).await;
    assert_eq!(positions(&iterations), [(0, 0), (0, 1), (0, 2), (1, 0), (2, 0), (2, 1), (2, 2)]);
    let Outcome::Failed(reason) = &iterations[3].outcome else { panic!("{:?}", iterations[3].outcome) };
    assert!(reason.starts_with("cannot reset the sensor for an episode: RuntimeError: no arm"), "{reason}");
    assert_eq!(iterations.iter().filter(|iteration| iteration.outcome == Outcome::Ok).count(), 6);
    let warm_up: Vec<bool> = iterations.iter().map(|iteration| iteration.warm_up).collect();
    assert_eq!(
        warm_up,
        [true, false, false, false, true, false, false],
        "the failed iteration is not warm-up"
    );
    assert_eq!(results(&iterations), [(0, 0.0, 1.5), (2, 0.0, 1.5)], "the failed episode has no return");
    assert_eq!(value(&iterations[3].tree, "episode-success"), Some(0.0));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn only_sensors_and_actuators_with_reset_are_reset() {
    // The reward is the number of resets of the sensor (1 if the sensor has no reset). If the actuator has a reset, the
    // reward is ten times this number plus the number of resets of the actuator.
    for (objects, rewards) in [
        (("Camera", "Gripper"), [1.0, 1.0]),
        (("CountingCamera", "Gripper"), [1.0, 2.0]),
        (("Camera", "CountingGripper"), [11.0, 12.0]),
        (("CountingCamera", "CountingGripper"), [11.0, 22.0]),
    ] {
        let reported = |iterations: &[Iteration]| {
            for iteration in iterations {
                assert_eq!(iteration.outcome, Outcome::Ok, "{objects:?}");
            }
            iterations.iter().map(|iteration| value(&iteration.tree, "reward")).collect::<Vec<_>>()
        };
        let [first_reward, second_reward] = rewards.map(Some);
        let keys = "episode_steps = 2\nlimit = { episodes = 2 }\nwarm_up = { iterations = 0 }";
        let iterations = run("kind = 'echo'", objects, keys).await;
        assert_eq!(
            reported(&iterations),
            [first_reward, first_reward, second_reward, second_reward],
            "{objects:?}"
        );
        let keys = "limit = { total = 3 }\nwarm_up = { iterations = 0 }";
        let iterations = run("kind = 'echo'", objects, keys).await;
        assert_eq!(reported(&iterations), [first_reward; 3], "{objects:?} without episodes");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn simulation_is_advanced_by_total_of_previous_iteration() {
    let keys = "episode_steps = 4\nlimit = { episodes = 4 }\nwarm_up = { iterations = 0 }";
    let iterations = run("kind = 'echo'", ("Simulation", "AdvanceReporter"), keys).await;
    let steps = |episode, steps: u32| (0..steps).map(move |step| (episode, step));
    // In the third episode the simulation fails before the third step, so this episode ends with a failed iteration.
    let expected: Vec<_> = steps(0, 4).chain(steps(1, 4)).chain(steps(2, 3)).chain(steps(3, 4)).collect();
    assert_eq!(positions(&iterations), expected);
    for pair in iterations.windows(2) {
        let (previous, next) = (&pair[0], &pair[1]);
        if (next.episode, next.step) == (2, 2) {
            let reason = next.outcome.reason().expect("the iteration failed");
            let text = "RuntimeError: unstable";
            assert!(
                reason.starts_with("cannot advance the simulation by ") && reason.contains(text),
                "{reason}"
            );
            continue;
        }
        assert_eq!(next.outcome, Outcome::Ok);
        assert_adds_up(next);
        let advanced = value(&next.tree, "reward");
        if next.step == 0 {
            assert_eq!(advanced, None, "a reset begins a new simulation");
            continue;
        }
        let total = value(&previous.tree, "total").expect("a total");
        assert!(
            (advanced.expect("the simulation was advanced") - total).abs() < 1e-6,
            "{advanced:?} after {total}"
        );
        let start = |iteration: &Iteration| iteration.tree.anchors()[0].wall;
        let pause = (start(next) - start(previous)).seconds() - total;
        assert!(pause >= 0.05, "advancing, which takes 50 ms, is outside of both iterations: {pause}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn open_loop_advances_simulation_before_each_sample() {
    // The answer to the second sample takes longer than the timeout. The actuator fails if a sample was taken without
    // an advance.
    let model = "kind = 'exec'\nworkers = 4\ncommand = '''while read -r word bytes media shape rest; do \
                 x=$(head -c \"$bytes\"); case $x in *'\"step\":2,'*|*'\"step\": 2,'*) sleep 0.6;; *) sleep 0.1;; esac; \
                 printf \"answer %d $media\\n%s\" \"$bytes\" \"$x\"; done'''";
    for load in ["rate", "poisson"] {
        for max_in_flight in [1, 4] {
            let keys = format!(
                "limit = {{ total = 6 }}\nwarm_up = {{ iterations = 0 }}\ntimeout_ms = 300\n\
                 load = {{ mode = '{load}', hz = 40.0 }}\nmax_in_flight = {max_in_flight}"
            );
            let iterations = run(model, ("Simulation", "AdvanceReporter"), &keys).await;
            let is_timeout = |iteration: &Iteration| matches!(iteration.outcome, Outcome::Timeout(_));
            assert_eq!(
                iterations.iter().filter(|iteration| is_timeout(iteration)).count(),
                1,
                "{iterations:#?}"
            );
            for pair in iterations.windows(2) {
                let (previous, next) = (&pair[0], &pair[1]);
                if !is_timeout(next) {
                    assert_adds_up(next);
                    assert_eq!(next.outcome, Outcome::Ok);
                    let total = value(&previous.tree, "total").expect("a total");
                    let advanced = value(&next.tree, "reward").expect("the simulation was advanced");
                    assert!((advanced - total).abs() < 1e-6, "{load}: {advanced} after {total}");
                }
            }
            let skipped: f64 =
                iterations.iter().filter_map(|iteration| value(&iteration.tree, "skipped-starts")).sum();
            assert!(skipped >= 3.0, "starts came due while an iteration was in flight: {skipped}");
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn episodes_without_answers_end_without_result() {
    let model = "kind = 'sleep'\nworkers = 8\ninference_ms = 2000";
    let keys = "episode_steps = 2\nlimit = { episodes = 2 }\nwarm_up = { iterations = 0 }\ntimeout_ms = 50";
    let iterations = run(model, ("Sensor", "Arm"), keys).await;
    assert_eq!(positions(&iterations), [(0, 0), (0, 1), (1, 0), (1, 1)]);
    assert!(iterations.iter().all(|iteration| matches!(iteration.outcome, Outcome::Timeout(_))));
    assert_eq!(results(&iterations), [], "the actuator never acted, so it reports nothing");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn hanging_actuator_fails_its_iteration_only() {
    let keys = "episode_steps = 3\nlimit = { episodes = 1 }\nwarm_up = { iterations = 0 }";
    let iterations = run("kind = 'echo'", ("Sensor", "Stuck"), keys).await;
    let outcomes: Vec<bool> = iterations.iter().map(|iteration| iteration.outcome == Outcome::Ok).collect();
    assert_eq!(outcomes, [true, false, true]);
    let reason = iterations[1].outcome.reason().expect("the iteration failed");
    assert!(reason.contains("own::Stuck did not answer within 0.3 s and was killed"), "{reason}");
    assert!(iterations[2].tree.find(&["actuation", "actuation-restart"]).is_some());
    assert_eq!(results(&iterations), [(0, 1.0, 2.0)]);
}
