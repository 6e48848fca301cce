//! Judging the delays of runs with raw stamps again. Only the raw stamps count, even if wall clocks are stepped. After a
//! machine is restarted, clock samples from before the restart are not used.

use peernet_clock::{RelatedClocks, Span, Verdict};

use super::TestStore;
use super::recomputing::{
    SAMPLED_SECONDS, assert_run_is_sound, assert_sound, continue_simulation, judgements_of, recompute,
    recompute_run, simulate_with_clocks, verdict_count,
};
use super::simulation::Simulation;
use crate::types::{DelayAssumptions, RecomputedStage};

/// Kinds of clock relations with a raw clock.
const RELATIONS: [RelatedClocks; 2] = [RelatedClocks::Raw, RelatedClocks::RawToWall];

/// Makes probes slow until five seconds after the start of a run. Later exchanges then narrow the earlier delays.
fn slow_first_seconds(second: i64, simulation: &mut Simulation) {
    simulation.congestion = if second < 5 { Span::from_millis(40) } else { Span::ZERO };
}

#[tokio::test]
async fn delays_are_judged_by_stored_raw_stamps() {
    for clocks in RELATIONS {
        let mut test_store = TestStore::new().await;
        let simulated =
            simulate_with_clocks(&mut test_store, clocks, SAMPLED_SECONDS, slow_first_seconds).await;
        let recomputed = recompute(&test_store).await;
        assert_eq!((recomputed.samples, recomputed.clocks.as_slice()), (125, &[clocks][..]));
        assert_sound(&test_store, &simulated).await;
        let (before, after) = judgements_of(&recomputed, "upload");
        assert!(
            verdict_count(after, Verdict::Ok) > verdict_count(before, Verdict::Ok),
            "{before:?} {after:?}"
        );
        for iteration in simulated.iterations.iter().step_by(100) {
            let stored =
                test_store.store.iteration(1, iteration.number).await.expect("answers").expect("stored");
            assert_eq!(stored.tree, iteration.tree);
        }
    }
}

#[tokio::test]
async fn wall_clock_steps_leave_delays_by_raw_stamps_unchanged() {
    type Step = fn(&mut Simulation);
    let steps: [Step; 4] = [
        |simulation| simulation.edge_ahead += Span::from_seconds(-7),
        |simulation| simulation.edge_ahead += Span::from_seconds(7),
        |simulation| simulation.edge_ahead += Span::from_seconds(-40),
        |simulation| simulation.cloud_ahead += Span::from_seconds(3),
    ];
    for step in steps {
        let mut test_store = TestStore::new().await;
        let simulated = simulate_with_clocks(
            &mut test_store,
            RelatedClocks::Raw,
            SAMPLED_SECONDS,
            |second, simulation| {
                slow_first_seconds(second, simulation);
                if second == 30 {
                    simulation.at_half_second = Some(step);
                }
            },
        )
        .await;
        // The column `window` has the number of the relation period.
        assert_eq!(test_store.count("SELECT count(DISTINCT window) FROM clock_sample").await, 1);
        let recomputed = recompute(&test_store).await;
        assert_sound(&test_store, &simulated).await;
        let (_, after) = judgements_of(&recomputed, "upload");
        assert_eq!(
            (verdict_count(after, Verdict::Stepped), verdict_count(after, Verdict::Inconsistent)),
            (0, 0),
            "{after:?}"
        );
        assert_eq!(after.delay.expect("has values").count, 600);
    }
}

/// Makes a simulation in which both machines were restarted. The simulation begins `after` the
/// start of a previous simulation. The edge's free-running clock shows the same times as in the
/// previous simulation, and the cloud's free-running clock shows about 12 s less. The offset of the
/// free-running clocks thus differs from that of the previous simulation.
fn simulation_after_restart(test_store: &TestStore, after: Span) -> Simulation {
    let mut restarted = Simulation::new(test_store.hosts(), RelatedClocks::Raw);
    restarted.now = after;
    restarted.raw_zeros =
        (restarted.raw_zeros.0 + after, restarted.raw_zeros.1 + after + Span::from_seconds(12));
    restarted.first_period += 100;
    restarted
}

#[tokio::test]
async fn runs_before_and_after_restart_use_own_relation_periods() {
    let mut test_store = TestStore::new().await;
    let first =
        simulate_with_clocks(&mut test_store, RelatedClocks::Raw, SAMPLED_SECONDS, slow_first_seconds).await;
    let restarted = simulation_after_restart(&test_store, Span::from_seconds(1_000));
    let second = continue_simulation(&mut test_store, restarted, SAMPLED_SECONDS, slow_first_seconds).await;
    for (run, simulated) in [(1, &first), (2, &second)] {
        let recomputed = recompute_run(&test_store, run).await;
        assert_eq!(recomputed.samples, 125, "run {run}");
        assert_run_is_sound(&test_store, run, simulated).await;
        let (before, after) = judgements_of(&recomputed, "upload");
        assert!(verdict_count(after, Verdict::Ok) > verdict_count(before, Verdict::Ok), "run {run}");
    }
}

#[tokio::test]
async fn times_repeated_after_restart_are_not_rejudged() {
    let mut test_store = TestStore::new().await;
    simulate_with_clocks(&mut test_store, RelatedClocks::Raw, SAMPLED_SECONDS, slow_first_seconds).await;
    // The edge has no battery: after the restart, its wall clock and its free-running clock both show the earlier
    // times again.
    let mut restarted = simulation_after_restart(&test_store, Span::from_seconds(1_000));
    restarted.edge_ahead = Span::from_seconds(-1_000);
    continue_simulation(&mut test_store, restarted, SAMPLED_SECONDS, slow_first_seconds).await;
    for run in [1, 2] {
        let recomputed = recompute_run(&test_store, run).await;
        assert_eq!((recomputed.samples, recomputed.clocks.len()), (0, 0), "run {run}");
        for RecomputedStage { before, after, .. } in recomputed.stages {
            assert_eq!(before, after);
        }
    }
}

/// More samples than a page have the same time of the edge's free-running clock. Only the last of them has exchanges that
/// narrow the delays before it.
#[tokio::test]
async fn samples_with_same_raw_time_are_read_over_page_boundary() {
    let mut test_store = TestStore::new().await;
    simulate_with_clocks(&mut test_store, RelatedClocks::Raw, (5, 20, 0), |second, simulation| {
        simulation.congestion = if second == 5 { Span::ZERO } else { Span::from_millis(40) };
    })
    .await;
    let mut connection = test_store.second_connection().await;
    for statement in [
        "CREATE TEMP TABLE copy AS \
         WITH RECURSIVE number (n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM number WHERE n < 1000) \
         SELECT sample.* FROM (SELECT * FROM clock_sample ORDER BY at_ns LIMIT 1 OFFSET 9) AS sample CROSS JOIN number",
        "UPDATE copy SET at_ns = at_ns + rowid",
        "INSERT INTO clock_sample SELECT * FROM copy",
        "UPDATE clock_sample SET at_raw_ns = (SELECT at_raw_ns FROM copy LIMIT 1) \
         WHERE at_ns = (SELECT at_ns FROM clock_sample ORDER BY at_ns LIMIT 1 OFFSET 1010)",
    ] {
        sqlx::query(statement).execute(&mut connection).await.expect("changes");
    }
    let recomputed = recompute(&test_store).await;
    let (before, after) = judgements_of(&recomputed, "upload");
    assert!(verdict_count(after, Verdict::Ok) > verdict_count(before, Verdict::Ok), "{before:?} {after:?}");
}

#[tokio::test]
async fn relation_periods_of_other_clocks_or_boots_are_not_used() {
    for change in [
        // 1 is the position of `RelatedClocks::RawToWall` in `RelatedClocks::ALL`.
        "UPDATE clock_sample SET clocks = 1",
        "UPDATE clock_sample SET clocks = NULL",
        "UPDATE clock_sample SET at_raw_ns = NULL",
        // The samples are of another boot: at these raw times, the edge's wall clock showed other times.
        "UPDATE clock_sample SET at_ns = at_ns + 5500000000",
    ] {
        let mut test_store = TestStore::new().await;
        simulate_with_clocks(&mut test_store, RelatedClocks::Raw, (5, 20, 0), slow_first_seconds).await;
        assert!(recompute(&test_store).await.samples > 0);
        sqlx::raw_sql(change).execute(&mut test_store.second_connection().await).await.expect("changes");
        let recomputed = recompute(&test_store).await;
        assert_eq!(recomputed.samples, 0, "{change}");
        assert!(recomputed.stages.iter().all(|stage| stage.before == stage.after), "{change}");
    }
}

#[tokio::test]
async fn each_delay_states_assumptions_of_its_bounds() {
    let raw_assumptions = DelayAssumptions {
        clocks: RelatedClocks::Raw,
        max_drift_ppm: Some(50.0),
        max_drift_change_ppm_per_s: Some(1.0),
        claims_trusted: Some(true),
        probes_authenticated: Some(true),
    };
    let wall_assumptions = DelayAssumptions {
        clocks: RelatedClocks::Wall,
        max_drift_change_ppm_per_s: None,
        claims_trusted: None,
        probes_authenticated: None,
        ..raw_assumptions
    };
    for (clocks, expected) in [(RelatedClocks::Raw, raw_assumptions), (RelatedClocks::Wall, wall_assumptions)]
    {
        let mut test_store = TestStore::new().await;
        simulate_with_clocks(&mut test_store, clocks, (5, 20, 0), slow_first_seconds).await;
        let rows = test_store.store.slowest_iterations(1, 50).await.expect("answers");
        let delays = || rows.iter().flat_map(|row| &row.delays);
        assert_eq!(delays().count(), 100);
        assert!(delays().all(|delay| delay.assumptions == Some(expected)), "{clocks}");
        let key = test_store.store.links().await.expect("answers")[0].key();
        assert_eq!(test_store.store.link_assumptions(&key).await.expect("answers"), Some(expected));
        // A relation period is authenticated only if all its probes are authenticated.
        let clear_authentication =
            "UPDATE clock_window SET probes_authenticated = 0 WHERE probes_authenticated = 1";
        sqlx::raw_sql(clear_authentication)
            .execute(&mut test_store.second_connection().await)
            .await
            .expect("changes");
        let assumptions = test_store.store.link_assumptions(&key).await.expect("answers").expect("stored");
        assert_eq!(assumptions.probes_authenticated, expected.probes_authenticated.map(|_| false));
    }
    let mut test_store = TestStore::new().await;
    test_store.store_run(3).await;
    let rows = test_store.store.slowest_iterations(1, 3).await.expect("answers");
    assert!(
        rows.iter().flat_map(|row| &row.delays).all(|delay| delay.assumptions.is_none()),
        "delays on one clock need no assumptions"
    );
}
