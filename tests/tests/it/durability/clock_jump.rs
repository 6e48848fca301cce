//! Test of an aggregator whose wall clock jumps by a month: nothing is deleted, and each jump is an incident.

use peernet_clock::Span;
use peernet_tests::fleet::echo_pipeline;
use peernet_tests::truth::query_database;
use peernet_tests::{
    AGGREGATOR, Api, FalseTime, LoopbackDeployment, Process, program, record_measurements, wait_until,
};

/// Number of iterations of each run.
const ITERATIONS: u64 = 300;
/// Number of stored iterations, including the warm-up.
const STORED_ITERATIONS: u64 = ITERATIONS + 5;
const MONTH: Span = Span::from_seconds(30 * 86_400);

/// Runs a pipeline to its end, on a separate host.
fn run_to_the_end(deployment: &LoopbackDeployment, api: &Api, host: &str) {
    let limit = format!("load = {{ mode = \"rate\", hz = 200.0 }}\nlimit = {{ iterations = {ITERATIONS} }}");
    let tables = format!("[[model]]\nname = \"echo\"\nkind = \"echo\"\n{}", echo_pipeline("loop", &limit));
    let agent = deployment.start_agent(host, &tables);
    api.wait_until("/api/v1/runs", |runs| {
        let is_finished = |run: &&serde_json::Value| run["host"] == host && run["reason"] == "finished";
        runs["runs"].as_array()?.iter().find(is_finished).map(|_| ())
    });
    assert_eq!(agent.stop().code(), 0);
}

/// Waits until `count` incidents of the aggregator report a clock step with this part of a
/// text; returns the newest text.
fn wait_for_jump_message(api: &Api, part: &str, count: usize) -> String {
    api.wait_until("/api/v1/incidents", |list| {
        let incidents = list["incidents"].as_array()?.iter();
        let steps =
            incidents.filter(|incident| incident["kind"] == "clock-step" && incident["host"].is_null());
        let texts: Vec<&str> = steps
            .filter_map(|incident| incident["text"].as_str())
            .filter(|text| text.contains(part))
            .collect();
        (texts.len() == count).then(|| texts[0].to_owned())
    })
}

#[test]
fn aggregator_clock_jumps_delete_nothing() {
    let deployment = LoopbackDeployment::new();
    let false_time = FalseTime::new(deployment.folder(), Span::ZERO);
    deployment.write("aggregator.toml", AGGREGATOR);
    let start = || {
        let process = Process::start(
            &program("peernetd"),
            &["run", "aggregator.toml"],
            deployment.folder(),
            &false_time.environment(),
        );
        let api = Api::on_port(deployment.http_port);
        wait_until("the dashboard", || api.get("/healthz").filter(|(status, _)| *status == 200));
        (process, api)
    };
    let (aggregator, api) = start();
    let database = deployment.folder().join("aggregator.sqlite");
    let assert_stored = |runs: u64| {
        assert_eq!(
            query_database(&database, "SELECT count(*) FROM iteration").trim(),
            (runs * STORED_ITERATIONS).to_string()
        );
        let sql = "SELECT count(DISTINCT run || ' ' || resolution_s) FROM rollup";
        assert_eq!(
            query_database(&database, sql).trim(),
            (runs * 5).to_string(),
            "{runs} runs have roll-ups of five resolutions each"
        );
    };
    run_to_the_end(&deployment, &api, "before");
    assert_stored(1);

    let mut messages = Vec::new();
    // Each offset is that of the aggregator's clock after a jump.
    for (offset, direction, count, host) in [
        (MONTH, "set forward by 30.0 days", 1, "forward"),
        (Span::ZERO, "set back by 30.0 days", 1, "back"),
        (-MONTH, "set back by 30.0 days", 2, "past"),
    ] {
        false_time.show(offset);
        messages.push(wait_for_jump_message(&api, direction, count));
        // Meanwhile retention runs once a second and after commits.
        run_to_the_end(&deployment, &api, host);
    }
    assert_stored(4);
    let log = aggregator.log();
    assert_eq!(log.matches("wall clock was set").count(), 3, "{log}");
    assert!(!log.contains("retention deleted"), "{log}");
    assert_eq!(aggregator.stop().code(), 0);

    // The aggregator starts with a clock that is behind its last stored time, and then with a clock that is far ahead.
    false_time.show(-MONTH - MONTH);
    let (aggregator, api) = start();
    messages.push(wait_for_jump_message(&api, "less than when the aggregator last stored something", 1));
    assert_eq!(aggregator.stop().code(), 0);
    false_time.show(MONTH);
    let (aggregator, api) = start();
    run_to_the_end(&deployment, &api, "after");
    assert_stored(5);
    assert_eq!(
        query_database(&database, "SELECT count(*) FROM incident WHERE kind = 'retention'").trim(),
        "0"
    );
    assert_eq!(aggregator.stop().code(), 0);
    record_measurements(
        "clock jumps of the aggregator",
        &[("incidents", messages.join("; ")), ("iterations stored", (5 * STORED_ITERATIONS).to_string())],
    );
}
