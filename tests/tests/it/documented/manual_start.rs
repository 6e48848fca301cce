//! The shipped configurations, started manually: on two machines, and all in one process.

use peernet_tests::network::Host;
use peernet_tests::truth::query_database;
use peernet_tests::{Api, Document, DocumentedCommands, wait_until};

pub(crate) const COMMANDS: [&str; 7] = [
    "target/demo/peernetd run configs/aggregator.toml",
    "target/demo/peernetd run configs/cloud.toml",
    "target/demo/peernetd run configs/edge.toml",
    "peernetd doctor --config configs/edge.toml",
    "target/demo/peernetd run configs/all-in-one.toml",
    "peernetd run configs/python.toml",
    "peernetd run configs/episodes.toml",
];

/// Waits until the dashboard on a host shows this number of answered iterations of a pipeline.
fn wait_until_answered(host: &Host, pipeline: &'static str, count: u64) {
    host.run_in_namespace(move || {
        Api::on_port(8040).wait_until("/api/v1/runs", |runs| {
            let runs = runs["runs"].as_array()?.iter();
            let pipeline_runs = runs.filter(|run| run["pipeline"] == pipeline);
            let sum: u64 = pipeline_runs.filter_map(|run| run["counts"]["ok"].as_u64()).sum();
            (sum >= count).then_some(())
        });
    });
}

#[test]
fn killed_aggregator_leaves_no_gap_on_dashboard() {
    let machines = DocumentedCommands::new(&COMMANDS);
    machines.copy("configs/aggregator.toml", &[("127.0.0.1:5550", "0.0.0.0:5550")]);
    machines.copy("configs/cloud.toml", &[("tcp://127.0.0.1:5551", "tcp://0.0.0.0:5551")]);
    machines.copy("configs/edge.toml", &[]);
    let start_aggregator = || machines.on_cloud("target/demo/peernetd run configs/aggregator.toml", &[]);
    let aggregator = start_aggregator();
    let cloud = machines.on_cloud("target/demo/peernetd run configs/cloud.toml", &[]);
    let edge = machines.on_edge("target/demo/peernetd run configs/edge.toml", &[]);
    for pipeline in ["local", "offload-full", "offload-resized"] {
        wait_until_answered(machines.cloud(), pipeline, 5);
    }

    aggregator.kill();
    wait_until("batches that wait", || {
        let doctor = machines.on_edge("peernetd doctor --config configs/edge.toml", &[]).wait_for_end();
        assert_eq!(doctor.code(), 0, "{}", doctor.log);
        doctor.log.contains("waiting: batches").then_some(())
    });
    let aggregator = start_aggregator();
    let output = edge.wait_for_nth("connected to the aggregator", 2);
    assert!(output.contains(" wait"), "the log does not say how many events wait: {output}");
    wait_until_answered(machines.cloud(), "offload-resized", 20);
    for process in [edge, cloud, aggregator] {
        let end = process.stop();
        assert_eq!(end.code(), 0, "{}", end.log);
    }
    // No iteration is missing, and none is stored twice.
    let database = machines.folder().join("data/aggregator/peernet.sqlite");
    let incomplete_runs =
        "SELECT run, count(*), max(number) FROM iteration GROUP BY run HAVING count(*) <> max(number)";
    assert_eq!(query_database(&database, incomplete_runs), "");

    // Each of the remaining files is for one machine only.
    for name in ["python.toml", "python/sweep.py", "python/nearest.py", "all-in-one.toml"] {
        let name = format!("configs/{name}");
        machines.write(&name, &Document::read(&*name).text);
    }
    let python = machines.on_cloud("peernetd run configs/python.toml", &[]);
    let all_in_one = machines.on_edge("target/demo/peernetd run configs/all-in-one.toml", &[]);
    wait_until_answered(machines.edge(), "over-the-network", 5);
    wait_until_answered(machines.cloud(), "scan", 5);
    for process in [python, all_in_one] {
        let end = process.stop();
        assert_eq!(end.code(), 0, "{}", end.log);
    }
    for name in ["episodes.toml", "python/reach.py"] {
        let name = format!("configs/{name}");
        machines.write(&name, &Document::read(&*name).text);
    }
    let episodes_agent = machines.on_cloud("peernetd run configs/episodes.toml", &[]);
    let success_rate = machines.cloud().run_in_namespace(|| {
        Api::on_port(8040).wait_until("/api/v1/runs", |runs| {
            let runs = runs["runs"].as_array()?.iter();
            runs.filter(|run| run["reason"] == "finished").find_map(|run| run["success_rate"].as_f64())
        })
    });
    assert_eq!(success_rate, 1.0, "not every target is reached");
    let ended = episodes_agent.stop();
    assert_eq!(ended.code(), 0, "{}", ended.log);
    machines.finish();
}
