//! Test of an aggregator whose wall clock jumps by a month: nothing is deleted, and each jump is an incident.

use peernet_clock::Span;
use peernet_tests::fleet::echo;
use peernet_tests::truth::query_database;
use peernet_tests::{
    AGGREGATOR, Api, FalseTime, LoopbackDeployment, Process, program, record_figures, wait_until,
};

/// Number of iterations of each run.
const ITERATIONS: u64 = 300;
/// Number of stored iterations, including the warm-up.
const STORED: u64 = ITERATIONS + 5;
const MONTH: Span = Span::from_seconds(30 * 86_400);

/// Runs a pipeline to its end, on a separate host.
fn run_to_the_end(deployment: &LoopbackDeployment, api: &Api, host: &str) {
    let limit = format!("load = {{ mode = \"rate\", hz = 200.0 }}\nlimit = {{ iterations = {ITERATIONS} }}");
    let tables = format!("[[model]]\nname = \"echo\"\nkind = \"echo\"\n{}", echo("loop", &limit));
    let agent = deployment.start_agent(host, &tables);
    api.wait_until("/api/v1/runs", |runs| {
        let end = |run: &&serde_json::Value| run["host"] == host && run["reason"] == "finished";
        runs["runs"].as_array()?.iter().find(end).map(|_| ())
    });
    assert_eq!(agent.stop().code(), 0);
}

/// Waits until this number of the aggregator's incidents report a clock step; returns the newest text.
fn wait_for_jump_message(api: &Api, direction: &str, times: usize) -> String {
    api.wait_until("/api/v1/incidents", |list| {
        let incidents = list["incidents"].as_array()?.iter();
        let steps = incidents.filter(|it| it["kind"] == "clock-step" && it["host"].is_null());
        let texts: Vec<&str> =
            steps.filter_map(|it| it["text"].as_str()).filter(|text| text.contains(direction)).collect();
        (texts.len() == times).then(|| texts[0].to_owned())
    })
}

#[test]
fn aggregator_clock_jumps_delete_nothing() {
    let deployment = LoopbackDeployment::new();
    let time = FalseTime::new(deployment.folder(), Span::ZERO);
    deployment.write("aggregator.toml", AGGREGATOR);
    let start = || {
        let process = Process::start(
            &program("peernetd"),
            &["run", "aggregator.toml"],
            deployment.folder(),
            &time.environment(),
        );
        let api = Api::on_port(deployment.http);
        wait_until("the dashboard", || api.get("/healthz").filter(|(status, _)| *status == 200));
        (process, api)
    };
    let (aggregator, api) = start();
    let database = deployment.folder().join("aggregator.sqlite");
    let stored = |runs: u64| {
        assert_eq!(
            query_database(&database, "SELECT count(*) FROM iteration").trim(),
            (runs * STORED).to_string()
        );
        let kinds = "SELECT count(DISTINCT run || ' ' || resolution_s) FROM rollup";
        assert_eq!(
            query_database(&database, kinds).trim(),
            (runs * 5).to_string(),
            "all widths of statistics of {runs} runs"
        );
    };
    run_to_the_end(&deployment, &api, "before");
    stored(1);

    let mut words = Vec::new();
    for (jump, direction, times, host) in [
        (MONTH, "set forward by 30.0 days", 1, "forward"),
        (Span::ZERO, "set back by 30.0 days", 1, "back"),
        (-MONTH, "set back by 30.0 days", 2, "past"),
    ] {
        time.show(jump);
        words.push(wait_for_jump_message(&api, direction, times));
        // Meanwhile retention runs once a second and after commits.
        run_to_the_end(&deployment, &api, host);
    }
    stored(4);
    let output = aggregator.log();
    assert_eq!(output.matches("wall clock was set").count(), 3, "{output}");
    assert!(!output.contains("retention deleted"), "{output}");
    assert_eq!(aggregator.stop().code(), 0);

    // It starts with a clock that is behind its last reading, and then with one that is far ahead.
    time.show(-MONTH - MONTH);
    let (aggregator, api) = start();
    words.push(wait_for_jump_message(&api, "less than when it last stored something", 1));
    assert_eq!(aggregator.stop().code(), 0);
    time.show(MONTH);
    let (aggregator, api) = start();
    run_to_the_end(&deployment, &api, "after");
    stored(5);
    assert_eq!(
        query_database(&database, "SELECT count(*) FROM incident WHERE kind = 'retention'").trim(),
        "0"
    );
    assert_eq!(aggregator.stop().code(), 0);
    record_figures(
        "clock jumps of the aggregator",
        &[("incidents", words.join("; ")), ("iterations stored", (5 * STORED).to_string())],
    );
}
