//! Test of an aggregator that is away for a long time and comes back.

use std::time::Duration;

use peernet_tests::fleet::{agent_configuration, echo_pipeline, rate_load};
use peernet_tests::truth::query_database;
use peernet_tests::{
    EventCounts, Fleet, Stopwatch, record_measurements, thousands, wait_until, wait_until_grown,
};

use super::{assert_nothing_lost, setting, wait_for_turn};

/// Interval of queries of the stored data.
const QUERY_INTERVAL: Duration = Duration::from_millis(100);
const DAY_S: f64 = 86_400.0;

/// Largest lag of the live state, in a debug build on a busy machine. `make bench` measures the relevant value, and
/// `make soak` sets a stricter limit.
const DEFAULT_MAX_LAG_MS: u64 = 5_000;

#[test]
fn day_long_outage_is_delivered_in_order() {
    let _turn = wait_for_turn();
    let iterations = setting("PEERNET_OUTAGE_ITERATIONS", 30_000);
    // The pipeline `day` runs as many iterations as a slow pipeline in a day. The pipeline `steady` runs meanwhile.
    let hz = setting("PEERNET_OUTAGE_HZ", 2_000) as f64;
    let flood =
        format!("warm_up = {{ iterations = 0 }}\nlimit = {{ iterations = {iterations} }}\n{}", rate_load(hz));
    let pipelines = echo_pipeline("day", &flood) + &echo_pipeline("steady", &rate_load(20.0));
    // At most half of the data fits into memory, which is enough for the seconds in which a busy machine's disk does not respond.
    let mut fleet = Fleet::new(&["edge"], &agent_configuration("queue_events = 16000", &pipelines));
    // The host is known before the aggregator stops.
    fleet.start(0);
    fleet.wait_for_counts(0, "the agent reports", |_| true);
    fleet.aggregator.kill();
    let agent = &fleet.agents[0];
    // The pipeline `steady` never reaches that number.
    wait_until_grown("the day's iterations are in the spool", iterations, || {
        agent.all_spooled_iterations().iter().map(|line| line.last).max()
    });

    fleet.restart_aggregator();
    let (stopwatch, before) = (Stopwatch::start(), stored_iterations(&fleet));
    let mut lags = Vec::new();
    let (mut newest, _) = before.unwrap_or_default();
    loop {
        let (number, has_ended) = wait_until("more iterations are stored", || {
            let counts = EventCounts::read(&fleet.api, "edge").filter(|counts| counts.connected)?;
            lags.push(counts.live_lag_s);
            std::thread::sleep(QUERY_INTERVAL);
            Some(stored_iterations(&fleet)?).filter(|(number, has_ended)| *number > newest || *has_ended)
        });
        newest = number;
        if has_ended {
            break;
        }
    }
    let seconds = stopwatch.elapsed().as_secs_f64();
    fleet.agents[0].stop();
    let counts = fleet.deliver_spool(0);
    let stored_events = fleet.stop();
    assert_nothing_lost(&fleet, &stored_events);
    counts.assert_balanced();
    let run = stored_events.runs.values().find(|run| run.pipeline == "day").expect("the pipeline has a run");
    assert_eq!((run.iterations(), run.reason.as_str()), (iterations, "finished"));

    lags.sort_by(f64::total_cmp);
    let lag = |share: f64| lags[((lags.len() - 1) as f64 * share) as usize];
    let delivered = (iterations - before.map_or(0, |(number, _)| number)) as f64;
    let per_second = delivered / seconds * (run.nodes as f64 / iterations as f64);
    let ms = |seconds: f64| format!("{:.0} ms", seconds * 1e3);
    record_measurements(
        "outage",
        &[
            ("iterations while away", thousands(delivered)),
            ("mean rate, if they took a day", format!("{:.2} Hz", iterations as f64 / DAY_S)),
            ("nodes", thousands(run.nodes as f64)),
            ("caught up in", format!("{seconds:.1} s")),
            ("nodes per second", thousands(per_second)),
            ("lag of the live state meanwhile, p50", ms(lag(0.5))),
            ("lag of the live state meanwhile, p99", ms(lag(0.99))),
            ("lost", thousands(0.0)),
        ],
    );
    assert!(
        lag(0.99) * 1e3 <= setting("PEERNET_LAG_MS", DEFAULT_MAX_LAG_MS) as f64,
        "the live state lagged by {}",
        ms(lag(0.99))
    );
    assert!(per_second >= setting("PEERNET_CATCH_UP", 1) as f64, "{per_second} nodes/s");
}

/// Returns the newest stored iteration of the pipeline `day`, and whether its run has ended. Checks that no iteration
/// before it is missing.
fn stored_iterations(fleet: &Fleet) -> Option<(u64, bool)> {
    let sql = "SELECT r.ok + r.warm_up + r.failed, coalesce((SELECT max(number) FROM iteration WHERE run = r.number), 0),
                      r.end_reason IS NOT NULL
               FROM run AS r JOIN pipeline AS p ON p.id = r.pipeline WHERE p.name = 'day'";
    let row = query_database(fleet.database(), sql);
    if row.is_empty() {
        return None;
    }
    let mut columns = row.trim().split('|').map(|column| column.parse::<u64>().expect("a count"));
    let (count, newest, end) = (columns.next()?, columns.next()?, columns.next()?);
    assert_eq!(count, newest, "iterations before the newest are missing");
    Some((newest, end == 1))
}
