//! Tests of profiling a ROS system between two of its topics, without changes to its nodes.

use std::process::Command;

use peernet_tests::{Api, LoopbackDeployment, Process, Ros1System, python, wait_until};
use serde_json::Value;

/// Returns a pipeline that observes the nodes between two topics.
fn observing_pipeline(name: &str, input: &str, output: &str, keys: &str) -> String {
    format!(
        "[[pipeline]]\nname = \"{name}\"\ntimeout_ms = 500\n\
         placement = {{ kind = \"observe\", ros_version = 1, input = \"{input}\", output = \"{output}\" }}\n{keys}\n"
    )
}

/// Waits until a run has ended by itself, which may be older than other runs; returns its number.
fn wait_for_finished_run(api: &Api) -> i64 {
    api.wait_until("/api/v1/runs", |runs| {
        let mut runs = runs["runs"].as_array()?.iter();
        runs.find(|run| run["reason"] == "finished")?["number"].as_i64()
    })
}

/// Returns the median of a stage or value of a run, within 1 %.
fn median(api: &Api, run: i64, name: &str) -> f64 {
    let statistics = api.stage_statistics(run, name).unwrap_or_else(|| panic!("run {run} has no {name}"));
    statistics["p50"].as_f64().unwrap_or_else(|| panic!("{statistics}"))
}

/// Number of messages whose median is computed. A relay computes its median over the same number.
const MEDIAN_WINDOW: usize = 20;

/// Returns the median latency of the newest iterations of a pipeline's only run, seconds.
fn latency(api: &Api, pipeline: &str) -> Option<f64> {
    let runs = api.json("/api/v1/runs");
    let run = runs["runs"].as_array()?.iter().find(|run| run["pipeline"] == pipeline)?["number"].as_i64()?;
    let iterations = api.json(&format!("/api/v1/runs/{run}/iterations?limit=1000"));
    let newest = iterations["iterations"].as_array()?.iter().rev().take(MEDIAN_WINDOW);
    let mut totals: Vec<f64> = newest.filter_map(|iteration| iteration["total"].as_f64()).collect();
    totals.sort_by(f64::total_cmp);
    (totals.len() == MEDIAN_WINDOW).then(|| totals[MEDIAN_WINDOW / 2])
}

/// Returns the latest median of a relay's own delay, seconds.
fn relay_delay(relay: &Process) -> Option<f64> {
    let log = relay.log();
    let line = log.lines().rfind(|line| line.starts_with("median"))?;
    Some(line.split(' ').nth(1)?.parse::<f64>().ok()? * 1e-6)
}

/// Returns the number of stored and answered iterations of a pipeline's only run.
fn answered_iterations(api: &Api, pipeline: &str) -> u64 {
    let runs: Value = api.json("/api/v1/runs");
    let mut runs = runs["runs"].as_array().expect("a list").iter();
    let run = runs.find(|run| run["pipeline"] == pipeline);
    run.and_then(|run| run["counts"]["ok"].as_u64()).unwrap_or_default()
}

#[test]
fn chain_latencies_are_right_within_a_millisecond() {
    let (deployment, ros) = (LoopbackDeployment::new(), Ros1System::new());
    let (_aggregator, api) = deployment.start_aggregator();
    let hops = [("5", "/camera", "/a"), ("20", "/a", "/b"), ("50", "/b", "/c")];
    let relay = |(delay, from, to): &(&str, &str, &str)| {
        // "0": the relay drops no message.
        ros.start_node(&["relay", &format!("relay{delay}"), from, to, delay, "0"])
    };
    let relays: Vec<Process> = hops.iter().map(relay).collect();
    let tables: String = hops
        .iter()
        .map(|(delay, from, to)| observing_pipeline(&format!("hop{delay}"), from, to, ""))
        .collect();
    let limit = "limit = { iterations = 40 }";
    let agent = ros.start_agent(
        &deployment,
        "robot",
        &(tables + &observing_pipeline("whole", "/camera", "/c", limit)),
    );
    let _camera = ros.start_node(&["camera", "camera", "/camera", "10"]);

    // On a busy machine, nodes and agent wait for a processor. The comparison is repeated until neither waited during
    // the last two seconds, the time of the messages of one median.
    let mut sum = 0.0;
    for ((delay, ..), relay) in hops.iter().zip(&relays) {
        let seconds = wait_until(&format!("a median within a millisecond of {delay} ms"), || {
            let (reported, relay_seconds) = (latency(&api, &format!("hop{delay}"))?, relay_delay(relay)?);
            ((reported - relay_seconds).abs() < 1e-3).then_some(relay_seconds)
        });
        let delay_ms: f64 = delay.parse().expect("a number");
        assert!(seconds >= delay_ms * 1e-3, "{seconds}");
        sum += delay_ms * 1e-3;
    }
    // Only the pipeline `whole` has a limit.
    let whole_chain = wait_for_finished_run(&api);
    // A median of the API is within 1 % of the true one.
    assert!(median(&api, whole_chain, "total") >= sum * 0.99);
    api.assert_stages_sum_to_total(whole_chain, &["inference"]);

    // Rate and jitter of both topics, the age since the stamp, and the hosts of the publishers.
    for topic in ["input", "output"] {
        let period = median(&api, whole_chain, &format!("{topic}-period"));
        assert!((period - 0.1).abs() < 2e-2, "{topic}: {period}");
        assert!(median(&api, whole_chain, &format!("{topic}-jitter")) < 0.05, "{topic}");
    }
    // The camera stamps its messages when it publishes them.
    assert!(median(&api, whole_chain, "output-age") >= sum * 0.99);
    let run = api.json(&format!("/api/v1/runs/{whole_chain}"));
    let facts = run["facts"].to_string();
    for part in ["/camera (sensor_msgs/CompressedImage)", "/relay50 on this host", "header.stamp", "ROS 1"] {
        assert!(facts.contains(part), "{part} is missing in {facts}");
    }
    assert_eq!((&run["counts"]["ok"], &run["counts"]["lost"]), (&40.into(), &0.into()), "{run}");
    assert_eq!(agent.stop().code(), 0);
}

#[test]
fn unanswered_input_messages_are_lost_iterations() {
    let (deployment, ros) = (LoopbackDeployment::new(), Ros1System::new());
    let (_aggregator, api) = deployment.start_aggregator();
    let _camera = ros.start_node(&["camera", "camera", "/camera", "20"]);
    // The relay drops every fourth message.
    let _relay = ros.start_node(&["relay", "relay", "/camera", "/out", "2", "4"]);
    let keys = "warm_up = { iterations = 0 }\nlimit = { iterations = 40 }";
    let _agent = ros.start_agent(&deployment, "robot", &observing_pipeline("lossy", "/camera", "/out", keys));
    let run = wait_for_finished_run(&api);
    let detail = api.json(&format!("/api/v1/runs/{run}"));
    let count = |outcome: &str| detail["counts"][outcome].as_u64().expect("a count");
    assert_eq!(count("ok") + count("lost"), 40, "{detail}");
    assert_eq!(count("lost"), 10, "{detail}");
    let iterations = api.json(&format!("/api/v1/runs/{run}/iterations?unsuccessful=true")).to_string();
    assert!(
        iterations.contains("no message of /out with the same header.stamp within 500 ms"),
        "{iterations}"
    );
}

#[test]
fn observation_continues_after_ros_restart() {
    let (deployment, mut ros) = (LoopbackDeployment::new(), Ros1System::new());
    let (_aggregator, api) = deployment.start_aggregator();
    let agent = ros.start_agent(
        &deployment,
        "robot",
        &observing_pipeline("chain", "/camera", "/out", "warm_up = { iterations = 0 }"),
    );
    let wait_for_state = |text: &str| {
        api.wait_until("/api/v1/pipelines/robot/chain", |pipeline| {
            pipeline.to_string().contains(text).then(|| pipeline["run"].clone())
        })
    };
    wait_for_state("no node publishes /camera; no node publishes /out");
    let _camera = ros.start_node(&["camera", "camera", "/camera", "20"]);
    wait_for_state("no node publishes /out");
    let relay = ros.start_node(&["relay", "relay", "/camera", "/out", "2", "0"]);
    let answered = || answered_iterations(&api, "chain");
    wait_until("iterations", || (answered() > 5).then_some(()));
    let run = api.wait_until("/api/v1/pipelines/robot/chain", |pipeline| pipeline["run"].as_i64());

    relay.kill();
    wait_for_state("no node publishes /out");
    let _relay = ros.start_node(&["relay", "relay", "/camera", "/out", "2", "0"]);
    assert_eq!(wait_for_state("running"), run, "the same run continues");

    ros.kill_master();
    agent.wait_for("the ROS master is not reachable");
    ros.start_master();
    agent.wait_for("the ROS master does not know the node any more");
    let before = answered();
    wait_until("iterations after the master was restarted", || (answered() > before).then_some(()));
    let incidents = api.json("/api/v1/incidents").to_string();
    for part in
        ["the run continues when messages arrive again", "both observed topics have a publisher again"]
    {
        assert!(incidents.contains(part), "{part} is missing in {incidents}");
    }
    assert_eq!(agent.stop().code(), 0);
}

/// Calls a master or a node; returns the value of its answer.
fn call_ros(uri: &str, method: &str, arguments: &str) -> String {
    let code = format!("import xmlrpc.client as c; print(c.ServerProxy('{uri}').{method}({arguments})[2])");
    let output = Command::new(python()).args(["-c", &code]).output().expect("starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).trim().to_owned()
}

#[test]
fn run_at_its_limit_ends_without_node_and_master() {
    let (deployment, mut ros) = (LoopbackDeployment::new(), Ros1System::new());
    let (_aggregator, api) = deployment.start_aggregator();
    let keys = "warm_up = { iterations = 0 }\nlimit = { iterations = 1 }";
    let limited = observing_pipeline("limited", "/camera", "/never", keys)
        .replace("timeout_ms = 500", "timeout_ms = 600000");
    let unlimited = observing_pipeline("unlimited", "/camera", "/out", "");
    let agent = ros.start_agent(&deployment, "robot", &(limited + &unlimited));
    let _silent_relay = ros.start_node(&["relay", "silent", "/camera", "/never", "0", "1"]);
    let _relay = ros.start_node(&["relay", "relay", "/camera", "/out", "0", "0"]);
    let _camera = ros.start_node(&["camera", "camera", "/camera", "20"]);
    // The pipeline without a limit receives the same messages, and shows that the other pipeline has received the
    // message that reaches its limit.
    wait_until("iterations", || (answered_iterations(&api, "unlimited") > 20).then_some(()));
    let node = call_ros(&ros.uri(), "lookupNode", "'/test', '/peernet_robot_limited'");
    ros.kill_master();
    call_ros(&node, "shutdown", "'/test', 'user request'");
    let run = wait_for_finished_run(&api);
    let detail = api.json(&format!("/api/v1/runs/{run}"));
    assert_eq!((&detail["pipeline"], &detail["counts"]["lost"]), (&"limited".into(), &1.into()), "{detail}");
    assert_eq!(agent.stop().code(), 0);
}

#[test]
fn topic_without_header_is_refused_with_advice() {
    let (deployment, ros) = (LoopbackDeployment::new(), Ros1System::new());
    let (_aggregator, api) = deployment.start_aggregator();
    let _nodes = [ros.start_node(&["talk", "one", "/one"]), ros.start_node(&["talk", "two", "/two"])];
    let by_stamp = observing_pipeline("stamped", "/one", "/two", "");
    let by_order = observing_pipeline("ordered", "/one", "/two", "")
        .replace("ros_version", "pair_by = \"order\", ros_version");
    let _agent = ros.start_agent(&deployment, "robot", &(by_stamp + &by_order));
    api.wait_until("/api/v1/pipelines/robot/stamped", |pipeline| {
        let text = pipeline.to_string();
        (text.contains("has the type std_msgs/String") && text.contains("pair_by")).then_some(())
    });
    wait_until("iterations", || (answered_iterations(&api, "ordered") > 5).then_some(()));
}

#[test]
fn agent_waits_for_a_master() {
    let (deployment, mut ros) = (LoopbackDeployment::new(), Ros1System::new());
    let (_aggregator, api) = deployment.start_aggregator();
    ros.kill_master();
    let _agent = ros.start_agent(&deployment, "robot", &observing_pipeline("chain", "/camera", "/out", ""));
    api.wait_until("/api/v1/pipelines/robot/chain", |pipeline| {
        pipeline.to_string().contains("no ROS master answers at http://127.0.0.1").then_some(())
    });
    ros.start_master();
    api.wait_until("/api/v1/pipelines/robot/chain", |pipeline| {
        pipeline.to_string().contains("no node publishes /camera").then_some(())
    });
}

#[test]
fn check_refuses_unsupported_observation_of_ros_2() {
    let deployment = LoopbackDeployment::new();
    let check = |keys: &str| {
        let pipeline = observing_pipeline("two", "/in", "/out", "").replace("ros_version = 1", keys);
        deployment
            .write("it.toml", &format!("[agent]\nname = \"a\"\nstate_dir = \"{{folder}}/a\"\n{pipeline}"));
        let end = deployment.peernetd(&["check", "it.toml"]).wait_for_end();
        (end.code(), end.log)
    };
    let (code, log) = check("ros_version = 2, pair_by = \"sequence\"");
    assert_eq!(code, 78, "{log}");
    assert!(
        log.contains("pipeline[0].placement.pair_by: the headers of ROS 2 have no sequence number"),
        "{log}"
    );
    let (code, log) = check("ros_version = 2");
    if peernet_ros::ros2::IS_BUILT {
        assert_eq!(code, 0, "{log}");
    } else {
        assert_eq!(code, 78, "{log}");
        for part in ["pipeline[0].placement.ros_version: this build has no ROS 2", "cargo feature `ros2`"] {
            assert!(log.contains(part), "{part} is missing in:\n{log}");
        }
    }
}

#[test]
fn observing_pipeline_refuses_sensor_load_and_equal_topics() {
    let deployment = LoopbackDeployment::new();
    let pipeline = observing_pipeline("wrong", "/a", "/a", "load = { mode = \"rate\", hz = 1.0 }")
        .replace("timeout_ms", "sensor = { kind = \"synthetic\", size_bytes = 1 }\ntimeout_ms");
    deployment.write("it.toml", &format!("[agent]\nname = \"a\"\nstate_dir = \"{{folder}}/a\"\n{pipeline}"));
    let end = deployment.peernetd(&["check", "it.toml"]).wait_for_end();
    assert_eq!(end.code(), 78, "{}", end.log);
    for part in [
        "pipeline[0].sensor: a pipeline that observes does not use sensor",
        "pipeline[0].load: a pipeline that observes does not use load",
        "pipeline[0].placement.output: output is the same topic as input",
    ] {
        assert!(end.log.contains(part), "{part} is missing in:\n{}", end.log);
    }
}
