//! Test of two edges with different clocks that a cloud sees at the same address.

use peernet_clock::Span;
use peernet_tests::truth::{HostClock, Iteration};
use peernet_tests::{ClockShim, Network, TwoHostTestbed, wait_until};

use super::{CONSTANT_DRIFT, assert_contains_truth};

/// Returns the addresses of the peers that are connected to the cloud's port.
fn peers(testbed: &TwoHostTestbed) -> Vec<String> {
    let connections = testbed.network.cloud().run("ss", &["-Htn", "state", "established", "sport = :5551"]);
    let peer = |line: &str| Some(line.split_whitespace().last()?.rsplit_once(':')?.0.to_owned());
    connections.lines().filter_map(peer).collect()
}

#[test]
fn edges_behind_one_address_have_separate_clock_relations() {
    let testbed = TwoHostTestbed::new(|_| Network::behind_nat());
    // `third` is the edge on the network's third host.
    let shims =
        ["edge", "third"].map(|host| ClockShim::new(&testbed.folder().join(format!("{host}-clocks"))));
    let [edge, third] = &shims;
    edge.schedule_change(Span::from_seconds(40), 80.0, CONSTANT_DRIFT);
    third.schedule_change(Span::from_millis(-700), -120.0, CONSTANT_DRIFT);
    let _cloud = testbed.start_cloud("[clock]\ndiscipline = []\n");
    let tables = |name: &str| {
        let load = "load = { mode = \"rate\", hz = 50.0 }\nlimit = { iterations = 700 }";
        let clock = "[clock]\ntimestamps = \"user\"\ndiscipline = []\n";
        format!("clock_identity = \"{name}\"\n{clock}{}", testbed.pipeline(name, 1000, load))
    };
    let _edge = testbed.start_edge(&tables("edge"), &edge.environment());
    let _third = testbed.start_third_edge(&tables("third"), &third.environment());
    wait_until("both edges", || {
        let peers = peers(&testbed);
        (peers.len() == 2).then(|| assert_eq!(peers[0], peers[1]))
    });
    testbed.wait_for_runs(2);

    let iterations = testbed.iterations();
    let runs = testbed.api.json("/api/v1/runs");
    let clocks = shims.each_ref().map(|shim| HostClock::with_shim_errors(shim.errors()));
    for (host, clock) in ["edge", "third"].into_iter().zip(clocks) {
        let run = runs["runs"].as_array().expect("a list").iter().find(|run| run["host"] == host);
        let number = run.and_then(|run| run["number"].as_u64()).expect("the host has a run");
        let run_iterations: Vec<Iteration> =
            iterations.iter().filter(|iteration| iteration.run == number).cloned().collect();
        let case = format!("{host} behind one address");
        let (up, down) = assert_contains_truth(&case, &run_iterations, &clock, &HostClock::of_kernel());
        // The warm-up adds 5 iterations to the limit of 700.
        assert_eq!((up.compared, down.compared), (705, 705), "{case}");
        let probes = format!(
            "SELECT sum(probes_answered) > 20 FROM clock_sample JOIN link ON link.id = clock_sample.link \
             JOIN host ON host.id = link.edge WHERE host.name = '{host}'"
        );
        assert_eq!(testbed.query_database(&probes).trim(), "1", "{case}: too few probes are answered");
    }
}
