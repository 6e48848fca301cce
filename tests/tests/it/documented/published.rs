//! The paper's commands in the documents, and the use of their results.

use peernet_tests::{Document, DocumentedCommands, wait_until};

use super::paper::add_small_model;
use crate::experiments::column;

pub(crate) const COMMANDS: [&str; 8] = [
    SERVER,
    CLIENT,
    CLIENT_WITH_OBJECT,
    COMPILER,
    "peernet compare results-local results-lan",
    "peernet plot results",
    "peernet plot results --kind histograms --x total",
    "peernet plot --kind length",
];

const SERVER: &str = "peernet --server --name cluster --network zmq-tcp --network-config net_config.yaml --model-name efficientnet_v2_s --device cpu --iterations 1005";
const CLIENT: &str = "peernet --client --name jetson-orin --network zmq-tcp --network-config net_config.yaml --dataset-loc sample-image.JPEG --iterations 1005 --result-loc results --generate-plots";
const CLIENT_WITH_OBJECT: &str = "peernet --client … --sensor-object sweep::Lidar";
const COMPILER: &str = "cc -O2 -o brightness docs/examples/external/brightness.c";

/// Replaces the number of iterations by a smaller number, which is enough for confidence intervals.
const FEWER_ITERATIONS: (&str, &str) = ("1005", "40");

/// The published file of devices, with this test's addresses.
const DEVICES: &str = "devices:\n  jetson-orin: 10.0.0.1\n  cluster: CLUSTER\nserver: cluster\n";

#[test]
fn paper_commands_in_documents_work_with_custom_code() {
    let machines = DocumentedCommands::new(&COMMANDS);
    machines.write("net_config.yaml", &DEVICES.replace("CLUSTER", DocumentedCommands::CLOUD_ADDRESS));
    machines.write("local.yaml", &DEVICES.replace("CLUSTER", "127.0.0.1"));
    run_with_model_and_picture(&machines);
    run_agent_with_programs(&machines);
    run_custom_objects(&machines);
    compare_and_plot_results(&machines);
    machines.finish();
}

/// Model whose answers differ in length, like those of a language model.
const TALKER: &str = "class Talker:\n    def infer(self, distances):\n        \
                      return 'word ' * (1 + int(1e4 * distances[0]) % 40)\n";

/// Executes the commands of docs/quick-start.md, with a model of the bank and a picture.
fn run_with_model_and_picture(machines: &DocumentedCommands) {
    add_small_model(machines, "efficientnet_v2_s");
    let picture = machines.folder().join("models/quality-control/pictures/part-0001.jpg");
    std::fs::copy(picture, machines.folder().join("sample-image.JPEG")).expect("writable");
    let server = machines.on_cloud(SERVER, &[FEWER_ITERATIONS]);
    let client = machines.on_edge(CLIENT, &[FEWER_ITERATIONS]).wait_for_end();
    let server = server.wait_for_end();
    assert_eq!((client.code(), server.code()), (0, 0), "{}\n{}", client.log, server.log);
    assert_eq!(column(&machines.folder().join("results/data.csv"), "outcome"), ["ok"; 40]);
    for name in ["summary.md", "upload-time.png", "series.svg", "run.json"] {
        assert!(machines.folder().join("results").join(name).is_file(), "{name}");
    }
}

/// Runs the document's agent with a sensor, a model and an actuator, each of which is a program.
fn run_agent_with_programs(machines: &DocumentedCommands) {
    assert_eq!(machines.on_edge(COMPILER, &[]).wait_for_end().code(), 0);
    let document = Document::read("docs/external-programs.md");
    let (_, agent) = document.fenced_blocks("toml").remove(0);
    machines.write("own-programs.toml", &agent);
    let agent = machines.run_on(machines.edge(), "peernetd run own-programs.toml");
    wait_until("answers", || {
        let answers = std::fs::read_to_string(machines.folder().join("answers.txt")).ok()?;
        (answers.lines().count() >= 5 && answers.contains("bright")).then_some(())
    });
    let end = agent.stop();
    assert_eq!(end.code(), 0, "{}", end.log);
}

/// Runs Python objects at both ends on one machine, and programs at both ends on two.
fn run_custom_objects(machines: &DocumentedCommands) {
    machines.write("sweep.py", &Document::read("configs/python/sweep.py").text);
    machines.write("talker.py", TALKER);
    let server = |model: &str, devices: &str| {
        format!(
            "PEERNet --server --name cluster --network-config {devices} --iterations 40 --model-name {model}"
        )
    };
    let client = |devices: &str, results: &str| {
        format!("--name jetson-orin --network-config {devices} --iterations 40 --result-loc {results}")
    };
    let local_server = machines.run_on(machines.edge(), &server("talker::Talker", "local.yaml"));
    let local_client =
        machines.on_edge(CLIENT_WITH_OBJECT, &[("…", &client("local.yaml", "results-local"))]).wait_for_end();
    let local_server = local_server.wait_for_end();
    assert_eq!(
        (local_client.code(), local_server.code()),
        (0, 0),
        "{}\n{}",
        local_client.log,
        local_server.log
    );

    let lan_server = machines.run_on(machines.cloud(), &server("exec:./brightness", "net_config.yaml"));
    let sensor = ("sweep::Lidar", "exec:docs/examples/external/light.sh");
    let lan_client = machines
        .on_edge(CLIENT_WITH_OBJECT, &[("…", &client("net_config.yaml", "results-lan")), sensor])
        .wait_for_end();
    let lan_server = lan_server.wait_for_end();
    assert_eq!((lan_client.code(), lan_server.code()), (0, 0), "{}\n{}", lan_client.log, lan_server.log);
    // The program on the cloud answered every picture of the edge's program correctly.
    assert_eq!(column(&machines.folder().join("results-lan/data.csv"), "top-1"), ["1"; 40]);
}

fn compare_and_plot_results(machines: &DocumentedCommands) {
    let comparison = machines.on_edge("peernet compare results-local results-lan", &[]).wait_for_end();
    assert_eq!(comparison.code(), 0, "{}", comparison.log);
    assert!(comparison.log.contains("talker") && comparison.log.contains("brightness"), "{}", comparison.log);
    let length_options = [("length", "length results-local")];
    for (command, changes, figure) in [
        ("peernet plot results", &[] as &[_], "results/upload-throughput.svg"),
        ("peernet plot results --kind histograms --x total", &[], "results/total-histogram.png"),
        ("peernet plot --kind length", &length_options, "results-local/length.png"),
    ] {
        let plot = machines.on_edge(command, changes).wait_for_end();
        assert_eq!(plot.code(), 0, "{}", plot.log);
        assert!(machines.folder().join(figure).is_file(), "{figure}: {}", plot.log);
    }
}
