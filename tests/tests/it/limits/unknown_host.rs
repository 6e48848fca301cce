//! Test of an unknown host beside the two machines of docs/two-machines.md. The host sends garbage, silence, false
//! sizes and unfinished frames to every port.

use std::net::TcpStream;
use std::path::Path;

use peernet_tests::network::Host;
use peernet_tests::{DocumentedCommands, Process, Stopwatch, root, wait_until};
use serde_json::Value;

use super::peak_memory;
use crate::documented::two_machines::install;

/// Duration of the attack.
const SECONDS: u64 = 30;
/// Rate of the attack.
const BYTES_PER_SECOND: u64 = 4_000_000;

/// Peak memory that each of the two daemons on the cloud may have used. The buffers of an aggregator,
/// as docs/operating.md lists them, and its unfinished input take less than 500 MB in all.
const MAX_PEAK_BYTES: u64 = 512 << 20;

#[test]
fn unknown_host_stops_neither_storing_nor_dashboard() {
    let machines = DocumentedCommands::with_third_host();
    install(&machines);
    let _master = start_ros_master(&machines);
    change_configuration(&machines, machines.cloud(), "\"tcp://0.0.0.0:5551\"", LISTEN_ADDRESSES);
    change_configuration(
        &machines,
        machines.cloud(),
        "[[model]]",
        "[[model]]\nname = \"echo\"\nkind = \"echo\"\n\n[[model]]",
    );
    change_configuration(
        &machines,
        machines.edge(),
        "[[pipeline]]",
        &format!(
            "{}\n{}\n[[pipeline]]",
            pipeline_table("datagrams", "udp://10.0.0.2:5552"),
            pipeline_table("topics", "ros1://10.0.0.2:11311/cloud")
        ),
    );
    let (edge, cloud) = (machines.edge(), machines.cloud());
    let start_daemon =
        |host: &Host, name: &str| machines.run_on(host, &daemon_command(&machines, host, name));
    let (aggregator, cloud_agent, robot_agent) =
        (start_daemon(cloud, "aggregator"), start_daemon(cloud, "agent"), start_daemon(edge, "agent"));
    aggregator.wait_for("ready");
    // The cloud logs the session of the pipeline over ROS.
    cloud_agent.wait_for("for its pipeline topics");
    let before = wait_until("the robot's iterations are stored", || {
        stored_events(&machines).filter(|events| *events > 20)
    });

    let attack = start_attack(&machines);
    let (stopwatch, mut latest) = (Stopwatch::start(), before);
    // The loop ends some seconds before the attack, so that every query is made during the attack.
    while stopwatch.elapsed().as_secs() < SECONDS - 5 {
        latest = wait_until("more stored events on the dashboard", || {
            stored_events(&machines).filter(|events| *events > latest)
        });
        assert_eq!(
            machines.run_on(edge, &curl_command("/")).wait_for_end().code(),
            0,
            "the overview is not served"
        );
    }
    let end = attack.wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    for process in [&aggregator, &cloud_agent] {
        let peak = peak_memory(process);
        assert!(peak < MAX_PEAK_BYTES, "{peak} bytes of memory at the peak: {}", end.log);
    }

    assert_eq!(robot_agent.stop().code(), 0);
    let robot_state = wait_until("all is stored", || {
        request_robot_state(&machines).filter(|host| host["now"]["events"]["waiting"] == 0)
    });
    let events = &robot_state["now"]["events"];
    assert_eq!(events["dropped"], 0, "{robot_state}");
    assert_eq!(robot_state["stored"]["missing"], 0, "{robot_state}");
    let runs = request_json(&machines, "/api/v1/runs").expect("the dashboard answers");
    let counts_of = |pipeline: &str| {
        let runs = runs["runs"].as_array().expect("a list");
        let run = runs.iter().find(|run| run["pipeline"] == pipeline);
        &run.unwrap_or_else(|| panic!("no run of {pipeline}: {runs:?}"))["counts"]
    };
    for pipeline in ["inspection", "topics"] {
        let counts = counts_of(pipeline);
        assert_eq!((&counts["lost"], &counts["timeout"]), (&0.into(), &0.into()), "{pipeline}: {counts}");
    }
    assert!(counts_of("topics")["ok"].as_u64().is_some_and(|answered| answered > 150), "{runs}");
    // The attack may cause lost datagrams, but most must arrive.
    let datagram_counts = counts_of("datagrams");
    let count =
        |name: &str| datagram_counts[name].as_u64().unwrap_or_else(|| panic!("no {name}: {datagram_counts}"));
    let unanswered = count("failed") + count("lost") + count("timeout");
    assert!(count("ok") > 150 && count("ok") > 9 * unanswered, "{datagram_counts}");
    assert_eq!(cloud_agent.stop().code(), 0);
    assert_eq!(aggregator.stop().code(), 0);
}

/// Returns the table of an additional pipeline. Over UDP, each of its samples takes several datagrams.
fn pipeline_table(name: &str, peer: &str) -> String {
    format!(
        "[[pipeline]]\nname = \"{name}\"\nsensor = {{ kind = \"synthetic\", size_bytes = 100000 }}\n\
         placement = {{ kind = \"remote\", peer = \"{peer}\", model = \"echo\" }}\n\
         load = {{ mode = \"rate\", hz = 10.0 }}\n"
    )
}

/// Addresses at which the cloud serves models, one per network.
const LISTEN_ADDRESSES: &str =
    r#"["tcp://0.0.0.0:5551", "udp://0.0.0.0:5552", "ros1://10.0.0.2:11311/cloud"]"#;

/// Changes the configuration of a machine's agent.
fn change_configuration(machines: &DocumentedCommands, host: &Host, from: &str, to: &str) {
    let file = machines.root_of(host).join("etc/peernet/agent.toml");
    let text = std::fs::read_to_string(&file).expect("it is installed");
    assert!(text.contains(from), "nothing to change: {text}");
    std::fs::write(&file, text.replacen(from, to, 1)).expect("it can be written");
}

/// Starts a ROS master on the cloud.
fn start_ros_master(machines: &DocumentedCommands) -> Process {
    let line = format!("env ROS_HOME={} rosmaster --core -p 11311", machines.folder().display());
    let master = machines.run_on(machines.cloud(), &line);
    wait_until("the ROS master", || {
        machines.cloud().run_in_namespace(|| TcpStream::connect("127.0.0.1:11311").ok())
    });
    master
}

fn daemon_command(machines: &DocumentedCommands, host: &Host, name: &str) -> String {
    let address = if host.address == machines.cloud().address { "10.0.0.2" } else { "10.0.0.1" };
    format!("env ROS_IP={address} peernetd run {}/etc/peernet/{name}.toml", machines.root_of(host).display())
}

fn start_attack(machines: &DocumentedCommands) -> Process {
    let program = root().join("tests/bench/peers/attack.py");
    let ports = "--events 5550 --data 5551 --udp-data 5552 --http 8040 --probes 8620 --ros-master 11311";
    let line = format!(
        "{} attack {} {ports} --seconds {SECONDS} --bytes-per-second {BYTES_PER_SECOND}",
        program.display(),
        machines.network().cloud_address_for_third_host()
    );
    let arguments: Vec<&str> = line.split(' ').collect();
    machines.network().third_host().start(Path::new("python3"), &arguments, machines.folder(), &[])
}

fn curl_command(path: &str) -> String {
    format!("curl --silent --fail --max-time 10 http://{}:8040{path}", DocumentedCommands::CLOUD_ADDRESS)
}

/// Requests a document from the robot's host.
fn request_json(machines: &DocumentedCommands, path: &str) -> Option<Value> {
    let end = machines.run_on(machines.edge(), &curl_command(path)).wait_for_end();
    assert_eq!(end.code(), 0, "{path} is not served: {}", end.log);
    serde_json::from_str(&end.log).ok()
}

fn request_robot_state(machines: &DocumentedCommands) -> Option<Value> {
    request_json(machines, "/api/v1/hosts")
        .and_then(|hosts| hosts["hosts"].as_array()?.iter().find(|host| host["name"] == "robot").cloned())
}

fn stored_events(machines: &DocumentedCommands) -> Option<u64> {
    request_robot_state(machines)?["stored"]["events"].as_u64()
}
