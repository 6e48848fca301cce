//! Tests of two agents that observe the same ROS system, each on its host, so that the network's share is known.

use std::path::Path;

use peernet_clock::Span;
use peernet_tests::network::{Host, Network, WireProperties};
use peernet_tests::truth::{HostClock, Iteration, compare};
use peernet_tests::{
    Api, LoopbackDeployment, Process, Ros1System, TwoHostTestbed, print_line, program, root, wait_until,
};
use serde_json::Value;

/// Returns a pipeline that observes `/camera` and `/result` together with the agent at `peer`.
fn robot_pipeline(peer: &str, keys: &str) -> String {
    format!(
        "[[pipeline]]\nname = \"detector\"\ntimeout_ms = 1000\nplacement = {{ kind = \"observe\", ros_version = 1, \
         input = \"/camera\", output = \"/result\", peer = \"{peer}\", peer_pipeline = \"model\" }}\n{keys}\n"
    )
}

/// Returns the pipeline of the other agent.
fn peer_pipeline(input: &str, output: &str) -> String {
    format!(
        "[[pipeline]]\nname = \"model\"\nplacement = {{ kind = \"observe\", ros_version = 1, input = \"{input}\", \
         output = \"{output}\" }}\n"
    )
}

/// Waits for a run of the robot's pipeline that has ended by itself; returns its number and details.
fn wait_for_finished_run(api: &Api) -> (i64, Value) {
    let number = api.wait_until("/api/v1/runs", |runs| {
        let mut runs = runs["runs"].as_array()?.iter();
        let run = runs.find(|run| run["pipeline"] == "detector" && run["reason"] == "finished")?;
        run["number"].as_i64()
    });
    (number, api.json(&format!("/api/v1/runs/{number}")))
}

/// Returns the median of a stage of a run, within 1 %, seconds.
fn median(api: &Api, run: i64, name: &str) -> f64 {
    let statistics = api.stage_statistics(run, name).unwrap_or_else(|| panic!("run {run} has no {name}"));
    statistics["p50"].as_f64().unwrap_or_else(|| panic!("{statistics}"))
}

/// Returns the number of iterations of a run that have a value.
fn count(api: &Api, run: i64, name: &str) -> u64 {
    api.stage_statistics(run, name).and_then(|statistics| statistics["count"].as_u64()).unwrap_or_default()
}

/// Returns the environment variables of ROS on a host.
fn ros_environment(master: &Host, host: &Host) -> [(&'static str, String); 2] {
    let uri = format!("http://{}:11311", master.address);
    [("ROS_MASTER_URI", uri), ("ROS_IP", host.address.to_string())]
}

fn as_str_pairs<'a>(variables: &'a [(&'static str, String); 2]) -> [(&'a str, &'a str); 2] {
    [(variables[0].0, &variables[0].1), (variables[1].0, &variables[1].1)]
}

/// Starts a node of `tests/ros/node.rs`, which explains the arguments.
fn start_node(host: &Host, variables: &[(&'static str, String); 2], arguments: &[&str]) -> Process {
    let node = host.start(&program("ros1-node"), arguments, root(), &as_str_pairs(variables));
    node.wait_for("ready");
    node
}

/// ROS system on two hosts: a camera on the edge, and a node on the cloud that answers. A message takes 30 ms to the
/// cloud and 5 ms back.
struct RosOverWire {
    /// Environment variables of ROS on the edge and on the cloud.
    variables: [[(&'static str, String); 2]; 2],
    /// The node on the cloud.
    answering_node: Process,
    _camera: Process,
    _master: Process,
    testbed: TwoHostTestbed,
}

impl RosOverWire {
    /// Starts the master, the camera, and the node on the cloud with these arguments.
    fn new(node_arguments: &[&str]) -> Self {
        let wire_direction = |delay_ms| WireProperties { delay_ms, jitter_ms: 0, loss_percent: 0 };
        let testbed =
            TwoHostTestbed::new(|folder| Network::wire(folder, wire_direction(30), wire_direction(5)));
        let (edge, cloud) = (testbed.network.edge(), testbed.network.cloud());
        let (edge_environment, cloud_environment) =
            (ros_environment(edge, edge), ros_environment(edge, cloud));
        let home = std::env::temp_dir().display().to_string();
        let environment = [&as_str_pairs(&edge_environment)[..], &[("ROS_HOME", home.as_str())]].concat();
        let master = edge.start(Path::new("rosmaster"), &["--core", "-p", "11311"], root(), &environment);
        let address = edge.address;
        wait_until("the ROS master", || {
            edge.run_in_namespace(move || std::net::TcpStream::connect((address, 11311)).ok().map(drop))
        });
        let camera = start_node(edge, &edge_environment, &["camera", "camera", "/camera", "20"]);
        let answering_node = start_node(cloud, &cloud_environment, node_arguments);
        Self {
            variables: [edge_environment, cloud_environment],
            answering_node,
            _camera: camera,
            _master: master,
            testbed,
        }
    }

    /// Starts the agent on the cloud, with these tables.
    fn start_cloud(&self, tables: &str) -> Process {
        self.testbed.start_cloud_with(tables, &as_str_pairs(&self.variables[1]))
    }

    /// Starts the agent on the edge, with these tables.
    fn start_edge(&self, tables: &str) -> Process {
        self.testbed.start_edge(tables, &as_str_pairs(&self.variables[0]))
    }

    /// Compares stored delays with the truth and with the delays of the wire, and the stage of the node with the
    /// node's own measurement. `clocks` are the edge's and the cloud's.
    fn assert_delays_contain_truth(
        &self,
        case: &str,
        run: i64,
        iterations: &[Iteration],
        clocks: [&HostClock; 2],
    ) {
        let (up, down) = compare(iterations, clocks[0], clocks[1]);
        for (direction, comparison) in [("upload", &up), ("download", &down)] {
            print_line(&format!("{case}, {direction}: {}", comparison.summary()));
            assert!(comparison.outside.is_empty(), "{direction}:\n{}", comparison.outside.join("\n"));
            assert!(comparison.compared >= 250, "{direction}: {}", comparison.summary());
            // An asymmetric network cannot be distinguished from an offset: the estimate is wrong by half of the
            // difference.
            assert!(
                comparison.error_quantile(0.5) < Span::from_millis(14),
                "{direction}: {}",
                comparison.summary()
            );
        }
        // True delays: the delay of the wire, and the time that programs on a busy machine add.
        for (truth, wire_ms) in [(up.truth_quantile(0.5), 30), (down.truth_quantile(0.5), 5)] {
            let (min, max) = (Span::from_millis(wire_ms - 1), Span::from_millis(wire_ms + 15));
            assert!(min < truth && truth < max, "{truth} is not between {min} and {max}");
        }
        let node_delay =
            self.answering_node.log().lines().rfind(|line| line.starts_with("median")).map(str::to_owned);
        let node_delay: f64 =
            node_delay.and_then(|line| line.split(' ').nth(1)?.parse().ok()).expect("a median");
        let inference = median(&self.testbed.api, run, "inference");
        assert!(
            (inference - node_delay * 1e-6).abs() < 3e-3,
            "{inference} s, and the node says {node_delay} us"
        );
        // The stages cover the whole time.
        assert!(self.testbed.api.mean(run, "unattributed").abs() < 1e-4);
        // The sizes of observed messages are not recorded, so there is no throughput.
        assert_eq!(self.testbed.api.stage_statistics(run, "upload-throughput"), None);
    }
}

/// Keys of a run that [`RosOverWire::assert_delays_contain_truth`] examines.
const KEYS: &str = "warm_up = { iterations = 20 }\nlimit = { iterations = 300 }";

#[test]
fn observed_delays_contain_truth_despite_clock_errors() {
    let ros_system = RosOverWire::new(&["relay", "model", "/camera", "/result", "20", "0"]);
    let testbed = &ros_system.testbed;
    let fault_table = |offset_ms: f64, drift_ppm: f64| {
        format!("[clock_fault]\noffset_ms = {offset_ms:?}\ndrift_ppm = {drift_ppm:?}\n")
    };
    // In the middle of the run the cloud's clock is stepped as well.
    let faults = fault_table(5_000.0, 20.0) + "steps = [{ at_s = 10.0, by_ms = 2000.0 }]\n";
    let _cloud = ros_system.start_cloud(&(faults + &peer_pipeline("/camera", "/result")));
    let agent =
        ros_system.start_edge(&(fault_table(-3_000.0, -20.0) + &robot_pipeline(&testbed.peer(), KEYS)));
    let clocks = (testbed.clock_of("edge"), testbed.clock_of("cloud"));
    let (run, detail) = wait_for_finished_run(&testbed.api);
    ros_system.assert_delays_contain_truth(
        "observed together",
        run,
        &testbed.iterations(),
        [&clocks.0, &clocks.1],
    );

    // Exchanges after the run narrow these delays as well.
    let recomputed = testbed.api.json(&format!("/api/v1/runs/{run}/recomputed"));
    assert!(recomputed["samples"].as_u64() > Some(0), "{recomputed}");
    let stages = recomputed["stages"].as_array().expect("a list");
    let width = |stage: &Value, time: &str| stage[time]["half_width"]["mean"].as_f64().expect("a width");
    assert_eq!(stages.len(), 2, "{recomputed}");
    assert!(stages.iter().all(|stage| width(stage, "after") <= width(stage, "before")), "{recomputed}");

    // The publisher on the other host must not be reported as one without an agent.
    let facts = detail["facts"].to_string();
    let publisher = format!("/model at {}, where the peer measures", testbed.network.cloud().address);
    for part in [publisher.as_str(), "/camera on this host", "cloud with its pipeline model"] {
        assert!(facts.contains(part), "{part} is missing in {facts}");
    }
    let placement = ["kind", "peer", "model"].map(|key| detail["placement"][key].as_str());
    assert_eq!(placement, [Some("remote"), Some("cloud"), Some("observed")], "{detail}");
    assert_eq!(agent.stop().code(), 0);
}

/// The node stamps its answers again, so no answer has the stamp of its input message.
#[test]
fn delays_of_messages_paired_by_sequence_contain_truth() {
    let ros_system = RosOverWire::new(&["restamp", "model", "/camera", "/result", "20"]);
    let testbed = &ros_system.testbed;
    let by_sequence =
        |pipeline: String| pipeline.replace("ros_version", "pair_by = \"sequence\", ros_version");
    let fault = "[clock_fault]\noffset_ms = 5000.0\ndrift_ppm = 20.0\n";
    let _cloud =
        ros_system.start_cloud(&(fault.to_owned() + &by_sequence(peer_pipeline("/camera", "/result"))));
    let agent = ros_system.start_edge(&by_sequence(robot_pipeline(&testbed.peer(), KEYS)));
    let cloud = testbed.clock_of("cloud");
    let (run, detail) = wait_for_finished_run(&testbed.api);
    ros_system.assert_delays_contain_truth(
        "observed together by sequence",
        run,
        &testbed.iterations(),
        [&HostClock::of_kernel(), &cloud],
    );
    assert_eq!(detail["counts"]["lost"], 0, "{detail}");
    assert!(detail["facts"].to_string().contains("sequence number"), "{detail}");
    // The age since the answer's stamp is the time of the way back. Since the stamp of the input message, the whole iteration
    // has passed.
    let (age, total) = (median(&testbed.api, run, "output-age"), median(&testbed.api, run, "total"));
    assert!(age < 0.025 && total > 0.05, "the answer is {age} s old after {total} s");
    assert_eq!(agent.stop().code(), 0);
}

/// A robot and a rack on this machine. The rack's agent has another topic for its input, which lacks every fourth
/// message.
#[test]
fn messages_that_the_peer_missed_are_counted() {
    let (deployment, ros) = (LoopbackDeployment::new(), Ros1System::new());
    let (_aggregator, api) = deployment.start_aggregator();
    let _nodes = [
        ros.start_node(&["relay", "copy", "/camera", "/copied", "0", "4"]),
        ros.start_node(&["relay", "model", "/camera", "/result", "10", "0"]),
    ];
    let serve = "[serve]\nlisten = \"tcp://127.0.0.1:{data}\"\ncalibration = false\n";
    let _rack =
        ros.start_agent(&deployment, "rack", &format!("{serve}{}", peer_pipeline("/copied", "/result")));
    let keys = "warm_up = { iterations = 0 }\nlimit = { iterations = 60 }";
    let agent = ros.start_agent(&deployment, "robot", &robot_pipeline("tcp://127.0.0.1:{data}", keys));
    api.wait_until("/api/v1/pipelines/robot/detector", |pipeline| {
        pipeline.to_string().contains("no node publishes /camera").then_some(())
    });
    let _camera = ros.start_node(&["camera", "camera", "/camera", "20"]);
    let (run, detail) = wait_for_finished_run(&api);
    let ok = detail["counts"]["ok"].as_u64().expect("a count");
    let (missing, answered_by_peer) = (count(&api, run, "peer-input-missing"), count(&api, run, "inference"));
    // A quarter of the 60 messages, and some more if the rack's run begins after the robot's.
    assert!((15..=25).contains(&missing), "{missing} of {ok}");
    assert_eq!((ok, missing + answered_by_peer), (60, 60), "{detail}");
    assert_eq!(count(&api, run, "peer-unanswered"), 0);
    assert_eq!(agent.stop().code(), 0);
}

#[test]
fn missing_peer_or_pipeline_is_named() {
    let (deployment, ros) = (LoopbackDeployment::new(), Ros1System::new());
    let (_aggregator, api) = deployment.start_aggregator();
    let _nodes = [
        ros.start_node(&["camera", "camera", "/camera", "20"]),
        ros.start_node(&["relay", "model", "/camera", "/result", "5", "0"]),
    ];
    let wait_for_state = |parts: &[&str]| {
        api.wait_until("/api/v1/pipelines/robot/detector", |pipeline| {
            let text = pipeline.to_string();
            parts.iter().all(|part| text.contains(part)).then_some(())
        });
    };
    let agent = ros.start_agent(
        &deployment,
        "robot",
        &robot_pipeline("tcp://127.0.0.1:{data}", "warm_up = { iterations = 0 }"),
    );
    let address = format!("tcp://127.0.0.1:{}", deployment.data_port);
    wait_for_state(&["cannot reach a cloud at", &address]);

    let serve = "[serve]\nlisten = \"tcp://127.0.0.1:{data}\"\n";
    let rack = |pipeline: &str| ros.start_agent(&deployment, "rack", &format!("{serve}{pipeline}"));
    let rack_without_topics = rack("");
    wait_for_state(&["refused the session: host rack observes no topics", "kind = \\\"observe\\\""]);
    assert_eq!(rack_without_topics.stop().code(), 0);

    let rack_with_other_pipeline =
        rack(&peer_pipeline("/camera", "/result").replace("\"model\"", "\"planner\""));
    wait_for_state(&[
        "host rack has no observing pipeline named model; its observing pipelines: planner; set peer_pipeline to one of them",
    ]);
    assert_eq!(rack_with_other_pipeline.stop().code(), 0);

    let pipeline = peer_pipeline("/camera", "/result");
    let rack_process = rack(&pipeline);
    wait_for_state(&["running"]);
    let run = api.wait_until("/api/v1/pipelines/robot/detector", |pipeline| pipeline["run"].as_i64());
    wait_until("iterations with the peer's stamps", || (count(&api, run, "inference") > 10).then_some(()));

    // The run continues without the peer, and with it again.
    rack_process.kill();
    wait_until("iterations without the peer's stamps", || {
        (count(&api, run, "peer-unanswered") > 10).then_some(())
    });
    let before = count(&api, run, "inference");
    let _restarted = rack(&pipeline);
    wait_until("iterations with the peer's stamps again", || {
        (count(&api, run, "inference") > before + 10).then_some(())
    });
    let incidents = api.json("/api/v1/incidents").to_string();
    for part in [
        "lost the connection to rack",
        "peer-unanswered",
        "connected to rack, which observes the same messages with its pipeline model",
    ] {
        assert!(incidents.contains(part), "{part} is missing in {incidents}");
    }
    assert_eq!(agent.stop().code(), 0);
}

#[test]
fn check_refuses_peer_without_message_key() {
    let deployment = LoopbackDeployment::new();
    let check = |pipeline: &str| {
        deployment
            .write("it.toml", &format!("[agent]\nname = \"a\"\nstate_dir = \"{{folder}}/a\"\n{pipeline}"));
        let end = deployment.peernetd(&["check", "it.toml"]).wait_for_end();
        (end.code(), end.log)
    };
    let with_peer = robot_pipeline("tcp://rack:5551", "");
    assert_eq!(check(&with_peer).0, 0);
    let (code, log) = check(&with_peer.replace("peer =", "pair_by = \"order\", peer ="));
    assert_eq!(code, 78, "{log}");
    for part in ["pipeline[0].placement.pair_by", "pair_by = \"stamp\"", "\"sequence\" in ROS 1"] {
        assert!(log.contains(part), "{part} is missing in:\n{log}");
    }
    let (code, log) = check(&with_peer.replace("peer = \"tcp://rack:5551\", ", ""));
    assert_eq!(code, 78, "{log}");
    assert!(log.contains("pipeline[0].placement.peer_pipeline: peer_pipeline needs a peer"), "{log}");
}
