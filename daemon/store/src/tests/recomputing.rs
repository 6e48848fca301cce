//! Judging the delays of a run again, with all stored clock samples: intervals never get wider, and stamps do not
//! change. Delays without clock samples keep their judgement.

use peernet_clock::{ClockClaim, DelaySource, Direction, OneWayDelay, RelatedClocks, Span, Verdict};
use peernet_logger::RunId;
use peernet_stream::{Event, Iteration, Outcome};

use super::simulation::{Simulation, delays};
use super::{TestStore, generate};
use crate::read::recompute::rejudge_delays;
use crate::types::{Judgement, RecomputedDelays, RecomputedStage};

/// Durations in seconds for which clocks are sampled: before, during and after the run.
pub(super) const SAMPLED_SECONDS: (i64, i64, i64) = (5, 60, 60);

pub(super) struct SimulatedRun {
    pub(super) iterations: Vec<Iteration>,
    /// The true one-way delays of each iteration: up, down.
    pub(super) true_delays: Vec<(Span, Span)>,
}

/// Stores a run of a simulation whose wall clocks are related. `change` may change the simulation at the start of each
/// second.
async fn simulate(
    test_store: &mut TestStore,
    seconds: (i64, i64, i64),
    change: impl FnMut(i64, &mut Simulation),
) -> SimulatedRun {
    simulate_with_clocks(test_store, RelatedClocks::Wall, seconds, change).await
}

/// Stores a run of a simulation of hosts whose clocks are related by `clocks`.
pub(super) async fn simulate_with_clocks(
    test_store: &mut TestStore,
    clocks: RelatedClocks,
    seconds: (i64, i64, i64),
    change: impl FnMut(i64, &mut Simulation),
) -> SimulatedRun {
    let simulation = Simulation::new(test_store.hosts(), clocks);
    continue_simulation(test_store, simulation, seconds, change).await
}

/// Stores a run of an existing simulation.
pub(super) async fn continue_simulation(
    test_store: &mut TestStore,
    mut simulation: Simulation,
    seconds: (i64, i64, i64),
    mut change: impl FnMut(i64, &mut Simulation),
) -> SimulatedRun {
    let run = RunId::random();
    let mut all_iterations = Vec::new();
    let mut events = vec![generate::run_started(run, "line", generate::at(0.0))];
    let (before, during, after) = seconds;
    for second in -before..during + after {
        change(second, &mut simulation);
        let is_running = (0..during).contains(&second);
        let (iterations, sample) = simulation.second(is_running.then_some(run));
        events.extend(iterations.iter().cloned().map(Event::Iteration));
        events.push(sample);
        all_iterations.extend(iterations);
    }
    let work: Vec<_> =
        events.chunks(100).map(<[Event]>::to_vec).map(|events| test_store.batch(events)).collect();
    let committed = test_store.commit(&work).await;
    assert!(committed.quarantined.is_empty(), "{:?}", committed.quarantined);
    SimulatedRun { iterations: all_iterations, true_delays: simulation.true_delays }
}

/// Judges the delays of run 1 again.
pub(super) async fn recompute(test_store: &TestStore) -> RecomputedDelays {
    recompute_run(test_store, 1).await
}

/// Judges the delays of a run again. Asserts that the judgements before agree with the stored statistics.
pub(super) async fn recompute_run(test_store: &TestStore, run: i64) -> RecomputedDelays {
    let recomputed = test_store.store.recompute(run).await.expect("answers").expect("exists");
    let stages = test_store.store.statistics_of(run).await.expect("answers").stages;
    for RecomputedStage { stage, before, .. } in &recomputed.stages {
        let stored = stages.iter().find(|candidate| candidate.stage == *stage).expect("has statistics");
        let bound = stored.bound.as_ref().expect("judged");
        assert_eq!(before.verdicts, bound.verdicts);
        let close = |a: f64, b: f64| (a - b).abs() < 1e-9;
        let (delay, half_width) = (before.delay.expect("has values"), before.half_width.expect("has bounds"));
        assert_eq!((delay.count, delay.max), (stored.statistics.count, stored.statistics.max));
        assert!(close(delay.mean, stored.statistics.mean));
        assert!(close(half_width.mean, bound.half_width.expect("has bounds").mean));
    }
    recomputed
}

/// Returns the judgements of a stage before and after the recomputation.
pub(super) fn judgements_of<'a>(
    recomputed: &'a RecomputedDelays,
    name: &str,
) -> (&'a Judgement, &'a Judgement) {
    let found_stage = recomputed.stages.iter().find(|candidate| candidate.stage == name);
    found_stage.map(|candidate| (&candidate.before, &candidate.after)).expect("has the stage")
}

pub(super) fn verdict_count(judgement: &Judgement, verdict: Verdict) -> u64 {
    judgement
        .verdicts
        .iter()
        .find(|(candidate, _)| *candidate == verdict)
        .map_or(0, |(_, verdict_count)| *verdict_count)
}

/// Asserts for every delay of run 1 what [`assert_run_is_sound`] asserts.
pub(super) async fn assert_sound(test_store: &TestStore, simulated: &SimulatedRun) {
    assert_run_is_sound(test_store, 1, simulated).await;
}

/// Asserts for every delay of a run that the new bounds contain the true delay and lie within the
/// previous bounds. A delay without new bounds has the same judgement as before.
pub(super) async fn assert_run_is_sound(test_store: &TestStore, run: i64, simulated: &SimulatedRun) {
    let mut judged_delays = 0;
    let samples = rejudge_delays(&test_store.store.readers, run, |delay| {
        let (Some(before), Some(after)) = (delay.before, delay.after) else {
            panic!("a delay is not judged: {delay:?}")
        };
        // Delays come in the order of iterations, the upload and the download of an iteration together.
        let (up, down) = simulated.true_delays[judged_delays / 2];
        let true_delay = if delay.direction == Direction::Up { up } else { down };
        if let Some(bounds) = after.bounds {
            assert!(bounds.contains(true_delay), "{true_delay} is outside: {delay:?}");
            assert!(after.value.is_some_and(|value| bounds.contains(value)), "{delay:?}");
            assert!(before.bounds.is_none_or(|previous| previous.hull(bounds) == previous), "{delay:?}");
        } else {
            assert_eq!(after, before);
        }
        judged_delays += 1;
    });
    assert!(samples.await.expect("answers").expect("exists") > 0);
    assert_eq!(judged_delays, 2 * simulated.iterations.len());
}

#[tokio::test]
async fn later_clock_samples_narrow_delays() {
    let mut test_store = TestStore::new().await;
    // Probes take long until five seconds after the start of the run, so only later probes give narrow bounds.
    let simulated = simulate(&mut test_store, SAMPLED_SECONDS, |second, simulation| {
        simulation.congestion = if second < 5 { Span::from_millis(40) } else { Span::ZERO };
    })
    .await;
    let recomputed = recompute(&test_store).await;
    assert_eq!((recomputed.number, recomputed.samples), (1, 125));
    assert_eq!(recomputed.clocks, [RelatedClocks::Wall], "the run has no raw stamps");
    assert_sound(&test_store, &simulated).await;
    let (before, after) = judgements_of(&recomputed, "upload");
    let widest = |judgement: &Judgement| judgement.half_width.expect("has bounds").max;
    assert!(widest(before) > 1e-3 && widest(after) < 0.7e-3, "{before:?} {after:?}");
    assert!(verdict_count(after, Verdict::Ok) > verdict_count(before, Verdict::Ok));
    // The stamps and judgements are stored as they were sent.
    for iteration in simulated.iterations.iter().step_by(100) {
        let stored = test_store.store.iteration(1, iteration.number).await.expect("answers").expect("stored");
        assert_eq!(stored.tree, iteration.tree);
    }
}

#[tokio::test]
async fn long_run_is_judged_in_pages() {
    let mut test_store = TestStore::new().await;
    // The clock samples and the delays of this run take several pages each.
    let simulated = simulate(&mut test_store, (5, 1_500, 5), |_, _| {}).await;
    let recomputed = recompute(&test_store).await;
    assert_eq!(recomputed.samples, 1_510);
    assert_sound(&test_store, &simulated).await;
    let (_, after) = judgements_of(&recomputed, "download");
    assert_eq!(after.delay.expect("has values").count, 15_000);
    assert_eq!(verdict_count(after, Verdict::Stale), 0);
}

#[tokio::test]
async fn delays_without_clock_samples_are_not_rejudged() {
    let mut test_store = TestStore::new().await;
    test_store.store_run(30).await;
    let recomputed = recompute(&test_store).await;
    assert_eq!((recomputed.samples, recomputed.stages.len()), (0, 2));
    assert!(recomputed.stages.iter().all(|stage| stage.before == stage.after));

    let mut test_store = TestStore::new().await;
    simulate(&mut test_store, (5, 20, 0), |_, _| {}).await;
    assert!(recompute(&test_store).await.samples > 0);
    sqlx::raw_sql("DELETE FROM clock_sample")
        .execute(&mut test_store.second_connection().await)
        .await
        .expect("deletes");
    let recomputed = recompute(&test_store).await;
    assert_eq!(recomputed.samples, 0);
    assert!(recomputed.stages.iter().all(|stage| stage.before == stage.after));
    assert!(test_store.store.recompute(2).await.expect("answers").is_none());
}

#[tokio::test]
async fn warm_up_and_unanswered_iterations_are_left_out() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let mut simulation = Simulation::new(test_store.hosts(), RelatedClocks::Wall);
    let mut events = vec![generate::run_started(run, "line", generate::at(0.0))];
    for second in 0..10 {
        let (mut iterations, sample) = simulation.second(Some(run));
        for iteration in &mut iterations {
            iteration.warm_up = second < 3;
            if second == 5 {
                iteration.outcome = Outcome::Timeout(String::new());
            }
        }
        events.extend(iterations.into_iter().map(Event::Iteration));
        events.push(sample);
    }
    let work = test_store.batch(events);
    test_store.commit(&[work]).await;
    let recomputed = recompute(&test_store).await;
    // Of ten seconds with ten iterations each, three are warm-up, and one has no answers.
    for RecomputedStage { before, after, .. } in &recomputed.stages {
        for judgement in [before, after] {
            assert_eq!(judgement.verdicts.iter().map(|(_, verdict_count)| verdict_count).sum::<u64>(), 60);
        }
    }
}

#[tokio::test]
async fn delays_before_and_after_step_are_judged_separately() {
    type Step = fn(&mut Simulation);
    let steps: [Step; 6] = [
        |simulation| simulation.step_cloud(Span::from_seconds(3)),
        |simulation| simulation.step_cloud(Span::from_millis(-5)),
        |simulation| simulation.step_edge(Span::from_seconds(7)),
        |simulation| simulation.step_edge(Span::from_seconds(-7)),
        // Neither host detects these steps: only the exchanges show them.
        |simulation| simulation.cloud_ahead += Span::from_seconds(3),
        |simulation| simulation.edge_ahead += Span::from_seconds(-7),
    ];
    for (step, at_half_second) in steps.into_iter().flat_map(|step| [(step, false), (step, true)]) {
        let mut test_store = TestStore::new().await;
        let simulated = simulate(&mut test_store, SAMPLED_SECONDS, |second, simulation| {
            simulation.congestion = if second < 5 { Span::from_millis(40) } else { Span::ZERO };
            match second {
                30 if at_half_second => simulation.at_half_second = Some(step),
                30 => step(simulation),
                _ => {}
            }
        })
        .await;
        // The column `window` has the number of the relation period.
        assert_eq!(test_store.count("SELECT count(DISTINCT window) FROM clock_sample").await, 2);
        let recomputed = recompute(&test_store).await;
        assert_sound(&test_store, &simulated).await;
        for stage in &recomputed.stages {
            assert_eq!(
                verdict_count(&stage.before, Verdict::Stepped),
                verdict_count(&stage.after, Verdict::Stepped)
            );
        }
        let (before, after) = judgements_of(&recomputed, "upload");
        let mean = |judgement: &Judgement| judgement.half_width.expect("has bounds").mean;
        assert!(mean(after) < mean(before));
    }
}

/// The cloud's clock jumps by less than a round trip, and the cloud does not report the jump. The edge's agent then
/// begins another relation period. Agents of earlier versions stayed in one relation period; their stored samples are
/// judged by exchanges alone.
#[tokio::test]
async fn unreported_jump_does_not_change_earlier_delays() {
    for (is_one_period, jump) in [(false, 3), (false, -3), (true, 3), (true, -3)] {
        let mut test_store = TestStore::new().await;
        let simulated = simulate(&mut test_store, (5, 60, 20), |second, simulation| {
            simulation.is_one_period = is_one_period;
            // Probes are too slow to show the jump. Only exchanges of data show it.
            simulation.congestion = Span::from_millis(20);
            if second == 30 {
                let forward: fn(&mut Simulation) =
                    |simulation| simulation.cloud_ahead += Span::from_millis(3);
                let back: fn(&mut Simulation) = |simulation| simulation.cloud_ahead += Span::from_millis(-3);
                simulation.at_half_second = Some(if jump > 0 { forward } else { back });
            }
        })
        .await;
        assert_sound(&test_store, &simulated).await;
        let recomputed = recompute(&test_store).await;
        let (_, after) = judgements_of(&recomputed, "upload");
        assert_eq!(
            verdict_count(after, Verdict::Inconsistent),
            0,
            "{jump} ms, one relation period: {is_one_period}"
        );
    }
}

#[tokio::test]
async fn time_daemon_claims_are_used_as_in_first_judgement() {
    let claim = |interval| Some(ClockClaim { source: DelaySource::Chrony, error: interval });
    for error_ms in [0, 50] {
        let mut test_store = TestStore::new().await;
        let simulated = simulate(&mut test_store, (5, 30, 5), |second, simulation| {
            simulation.congestion = Span::from_millis(40);
            let mut interval = simulation.offset_within(200);
            let claim_error = Span::from_millis(error_ms);
            // A claim with an error of 50 ms contradicts the exchanges.
            (interval.lo, interval.hi) = (interval.lo + claim_error, interval.hi + claim_error);
            simulation.claim((second >= 10).then_some(interval).and_then(claim));
        })
        .await;
        let recomputed = recompute(&test_store).await;
        let (before, after) = judgements_of(&recomputed, "upload");
        // Of the 300 iterations in 30 s, those of the first 10 s have no claim.
        if error_ms == 0 {
            assert_sound(&test_store, &simulated).await;
            assert_eq!(verdict_count(after, Verdict::Inconsistent), 0);
            assert_eq!(verdict_count(after, Verdict::Ok), 200);
            assert!(after.half_width.expect("has bounds").min < 0.21e-3);
        } else {
            let inconsistent = |delay: &OneWayDelay| delay.verdict == Verdict::Inconsistent;
            assert_eq!(simulated.iterations.iter().flat_map(delays).filter(inconsistent).count(), 400);
            assert_eq!(verdict_count(before, Verdict::Inconsistent), 200);
            assert_eq!(verdict_count(after, Verdict::Inconsistent), 200);
            assert_eq!(after.delay.expect("has values").count, 100);
        }
    }
}

/// Iterations may overlap, so a delay may be earlier than a delay of an earlier iteration. In this run, every delay is.
#[tokio::test]
async fn earlier_delay_is_judged_by_its_own_claim() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let mut simulation = Simulation::new(test_store.hosts(), RelatedClocks::Wall);
    // Exchanges give wide bounds, so the claims decide.
    simulation.congestion = Span::from_millis(40);
    let (mut iterations, mut samples) = (Vec::new(), Vec::new());
    for second in -5..105 {
        // The clocks drift apart by 20 ppm, so within 20 s the offset leaves a claim of ± 200 µs.
        let error = simulation.offset_within(200);
        simulation.claim(Some(ClockClaim { source: DelaySource::Chrony, error }));
        let is_running = (0..100).contains(&second);
        let (iterations_of_second, sample) = simulation.second(is_running.then_some(run));
        iterations.extend(iterations_of_second);
        samples.push(sample);
    }
    iterations.reverse();
    simulation.true_delays.reverse();
    for (iteration, number) in iterations.iter_mut().zip(1..) {
        iteration.number = number;
    }
    let mut events = vec![generate::run_started(run, "line", generate::at(0.0))];
    events.extend(samples);
    events.extend(iterations.iter().cloned().map(Event::Iteration));
    let work: Vec<_> =
        events.chunks(100).map(<[Event]>::to_vec).map(|events| test_store.batch(events)).collect();
    let committed = test_store.commit(&work).await;
    assert!(committed.quarantined.is_empty(), "{:?}", committed.quarantined);
    let simulated = SimulatedRun { iterations, true_delays: simulation.true_delays };
    assert_sound(&test_store, &simulated).await;
}

/// A delay without a clock sample near it is judged by the claim of a sample that is up to 50 s older. The clocks drift
/// apart by 20 ppm, so the offset leaves the claimed interval within 10 s.
#[tokio::test]
async fn claim_of_distant_sample_is_widened_by_drift() {
    let mut test_store = TestStore::new().await;
    let simulated = simulate(&mut test_store, (5, 60, 5), |_, simulation| {
        simulation.congestion = Span::from_millis(40);
        let error = simulation.offset_within(200);
        simulation.claim(Some(ClockClaim { source: DelaySource::Chrony, error }));
    })
    .await;
    let delete = "DELETE FROM clock_sample \
                  WHERE at_ns IN (SELECT at_ns FROM clock_sample ORDER BY at_ns LIMIT 50 OFFSET 10)";
    sqlx::query(delete).execute(&mut test_store.second_connection().await).await.expect("changes");
    let recomputed = recompute(&test_store).await;
    assert!(recomputed.samples > 0);
    assert_sound(&test_store, &simulated).await;
    let (_, after) = judgements_of(&recomputed, "upload");
    assert_eq!(verdict_count(after, Verdict::Inconsistent), 0, "{after:?}");
}

#[tokio::test]
async fn link_over_other_network_is_not_used() {
    let mut test_store = TestStore::new().await;
    simulate(&mut test_store, SAMPLED_SECONDS, |_, _| {}).await;
    assert_eq!(recompute(&test_store).await.samples, 125);
    let change_network = "UPDATE link SET network = 'zmq-udp'";
    sqlx::query(change_network).execute(&mut test_store.second_connection().await).await.expect("changes");
    let recomputed = recompute(&test_store).await;
    assert_eq!(recomputed.samples, 0);
    for RecomputedStage { before, after, .. } in recomputed.stages {
        assert_eq!(before, after);
    }
}
