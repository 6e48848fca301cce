//! The paper's experiments with their own files, on one server, with a small model in place of each large one.

use peernet_tests::{Document, DocumentedCommands};

use crate::experiments::{Results, column, wait_for_runs};

pub(crate) const COMMANDS: [&str; 13] = [
    "peernetd run cloud.toml",
    "peernet run configs/experiments/efficientnet.toml",
    ONE_MODEL,
    "peernet plot --kind paired results/efficientnet",
    "peernet run --check configs/experiments/teleoperation.toml",
    ONE_NETWORK,
    NO_NETWORK,
    "peernet compare teleoperation --format latex --out table.tex",
    "peernet compare teleoperation --baseline teleoperation/run-1",
    "peernet plot teleoperation --kind stacked --out figures",
    PAYLOADS,
    DETECTION_CLOUD,
    DETECTION,
];

const NO_NETWORK: &str = "peernet run --only Network=none configs/experiments/teleoperation.toml";
/// Measures one network. The test removes the option, so that all networks are measured.
const ONE_NETWORK: &str = "peernet run --only Network=LAN configs/experiments/teleoperation.toml";

/// Measures one model on one machine without a GPU.
const ONE_MODEL: &str = "peernet run --only Model=S --set pipeline.placement.peer=tcp://127.0.0.1:5551 --set pipeline.placement.device=cpu --set bank.devices='[\"cpu\"]' --set experiment.iterations=40 --result-loc results/short configs/experiments/efficientnet.toml";

/// `peernet run` with a Python that has Debian's packages.
const PYTHON_RUN: &str = "env PEERNET_PYTHON=/usr/bin/python3 peernet run";

/// Replaces the simulation, whose packages this machine may lack: pictures without an arm, and a controller that takes any action.
const ROBOT: &str = "
import json, socket, threading
from PIL import Image

class Cameras:
    def __init__(self):
        self.controller = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.controller.bind(('127.0.0.1', 9006))
        threading.Thread(target=self.serve, daemon=True).start()
    def reset(self): self.time = 0.0
    def advance(self, seconds): self.time += seconds
    def sample(self): return (Image.new('RGB', (640, 480)), Image.new('RGB', (640, 480)))
    def serve(self):
        while True:
            line, sender = self.controller.recvfrom(65507)
            action = json.loads(line)
            [velocity] = action['answer']
            assert len(velocity) == 3, velocity
            feedback = {'iteration': action['iteration'], 'reward': -self.time, 'success': action['step'] == 2}
            self.controller.sendto(json.dumps(feedback).encode(), sender)
";

const DETECTION_CLOUD: &str = "peernetd run configs/detection-cloud.toml";
const DETECTION: &str = "peernet run configs/experiments/detection-line.toml";

const PAYLOADS: &str = "peernet run --set experiment.iterations=100 --set pipeline.placement.peer=tcp://10.0.0.2:5551 configs/experiments/payload-study.toml";

/// The document's options for a machine without a GPU, with fewer iterations.
const TEST_OPTIONS: &str = "run --set network.config=net_config.yaml --set bank.devices='[\"cpu\"]' \
                    --set pipeline.placement.device=cpu --set experiment.iterations=3";

const MODELS: [&str; 3] = ["efficientnet_v2_s", "efficientnet_v2_m", "efficientnet_v2_l"];

/// Adds a small model under this name, because the real model takes seconds on a machine without a GPU.
pub(crate) fn add_small_model(machines: &DocumentedCommands, name: &str) {
    let card = Document::read("models/quality-control/model.toml").text;
    let folder = format!("models/{name}");
    machines.write(&format!("{folder}/model.toml"), &card.replace("quality-control", name));
    let network = peernet_tests::root().join("models/quality-control/model.onnx");
    std::os::unix::fs::symlink(network, machines.folder().join(folder).join("model.onnx")).expect("writable");
}

/// Returns a text in which the policy of the teleoperation is a folder of the checkout.
fn with_policy(text: &str) -> String {
    let folder = peernet_tests::root().join("models/teleoperation-policy");
    text.replace("models/teleoperation-policy", folder.to_str().expect("the path is Unicode"))
}

/// Installs the document's agent for the server, with the models of the teleoperation; processors replace GPUs.
fn install_server(machines: &DocumentedCommands) {
    let document = Document::read("docs/experiments/classification.md");
    let agents = document.fenced_blocks("toml").into_iter().map(|(_, text)| text);
    let agent = agents.into_iter().find(|text| text.contains("[bank]")).expect("it has an agent with a bank");
    let teleoperation = Document::read("configs/teleoperation-cloud.toml").text;
    let (_, models) = teleoperation.split_once("\n[[model]]").expect("it has models");
    let agent = agent.replace("cuda:0", "cpu");
    machines.write("cloud.toml", &format!("{agent}\n[[model]]{}", with_policy(models)));
}

#[test]
fn paper_experiments_are_measured_compared_and_drawn() {
    let machines = DocumentedCommands::new(&COMMANDS);
    MODELS.iter().for_each(|name| add_small_model(&machines, name));
    install_server(&machines);
    let cloud = machines.on_cloud("peernetd run cloud.toml", &[]);
    cloud.wait_for("ready");
    measure_efficientnet(&machines);
    measure_teleoperation(&machines);
    measure_payload_study(&machines);
    let end = cloud.stop();
    assert_eq!(end.code(), 0, "{}", end.log);
    measure_detection(&machines);
    machines.finish();
}

/// Measures one and two cameras that share a detector, with and without batches.
fn measure_detection(machines: &DocumentedCommands) {
    let detector = peernet_tests::root().join("models/defect-detector");
    let write = |file: &str, replacements: &[(&str, &str)]| {
        let detector = detector.to_str().expect("the path is Unicode");
        let text = Document::read(file).text.replace("models/defect-detector", detector);
        machines.write(file, &replacements.iter().fold(text, |text, (from, to)| text.replace(from, to)));
    };
    write("configs/detection-cloud.toml", &[("tcp://127.0.0.1:5551", "tcp://0.0.0.0:5551")]);
    let cloud_address = format!("tcp://{}:5551", DocumentedCommands::CLOUD_ADDRESS);
    write(
        "configs/experiments/detection-line.toml",
        &[
            ("tcp://127.0.0.1:5551", &cloud_address),
            ("duration_s = 20", "duration_s = 2"),
            ("[1, 4, 16]", "[1, 2]"),
        ],
    );
    let cloud = machines.on_cloud(DETECTION_CLOUD, &[]);
    cloud.wait_for("ready");
    let end = wait_for_runs(machines.on_edge(DETECTION, &[]), 4);
    assert_eq!(end.code(), 0, "{}", end.log);
    let results = Results::of(machines.folder().join("results/detection-line"));
    assert_eq!(results.states(), ["finished"; 4]);
    assert_eq!(column(&results.folder.join("compare.csv"), "edges"), ["1", "2", "1", "2"]);
    // The name of a folder has the labels of the run: batches are on, and one camera sends.
    for folder in results.folders().iter().filter(|folder| folder.contains("-on-1-")) {
        let sizes = column(&results.file(folder, "data.csv"), "inference_batch-size");
        // One camera has at most four pictures in flight.
        let is_possible = |size: &String| size.parse().is_ok_and(|size: f64| (1.0..=4.0).contains(&size));
        assert!(!sizes.is_empty() && sizes.iter().all(is_possible), "{sizes:?}");
    }
    assert!(results.folder.join("users.svg").is_file(), "{}", end.log);
    let end = cloud.stop();
    assert_eq!(end.code(), 0, "{}", end.log);
}

/// Measures three models locally and on the server.
fn measure_efficientnet(machines: &DocumentedCommands) {
    let file = "configs/experiments/efficientnet.toml";
    machines.write(file, &Document::read(file).text);
    let devices = Document::read("configs/experiments/networks/net_config.yaml").text;
    machines
        .write("net_config.yaml", &devices.replace("cluster.example.org", DocumentedCommands::CLOUD_ADDRESS));
    let experiment =
        machines.on_edge("peernet run configs/experiments/efficientnet.toml", &[("run", TEST_OPTIONS)]);
    let end = wait_for_runs(experiment, 6);
    assert_eq!(end.code(), 0, "{}", end.log);
    let results = Results::of(machines.folder().join("results/efficientnet"));
    assert_eq!(results.states(), ["finished"; 6]);
    let table = results.folder.join("compare.csv");
    assert_eq!(column(&table, "Where"), ["local", "local", "local", "cloud", "cloud", "cloud"]);
    assert_eq!(column(&table, "Model"), ["S", "M", "L", "S", "M", "L"]);
    let picture_bytes = (1280 * 960 * 3).to_string();
    for folder in results.folders().iter().filter(|folder| folder.contains("cloud")) {
        // The warm-up adds 5 iterations to the limit of 3.
        let sent = column(&results.file(folder, "data.csv"), "upload-bytes");
        assert!(sent.len() == 8 && sent.iter().all(|bytes| *bytes == picture_bytes), "{folder}: {sent:?}");
    }
    let address = [("127.0.0.1", DocumentedCommands::CLOUD_ADDRESS)];
    let end = machines.on_edge(ONE_MODEL, &address).wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    let places = column(&machines.folder().join("results/short/compare.csv"), "Where");
    assert_eq!(places, ["local", "cloud"], "{}", end.log);
    let figure = results.folder.join("paired.png");
    std::fs::remove_file(&figure).expect("the experiment drew the figure");
    let end = machines.on_edge("peernet plot --kind paired results/efficientnet", &[]).wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    assert!(figure.is_file(), "{}", end.log);
}

/// Measures nine combinations; one server stands for both servers of the paper in all three networks.
fn measure_teleoperation(machines: &DocumentedCommands) {
    for (network, addresses) in [
        ("lan", ["192.168.1.30", "192.168.1.40"]),
        ("can", ["10.20.0.30", "10.20.0.40"]),
        ("5g", ["10.8.0.30", "10.8.0.40"]),
    ] {
        let addresses = addresses.map(|address| (address, DocumentedCommands::CLOUD_ADDRESS));
        machines.copy(&format!("configs/experiments/networks/{network}.yaml"), &addresses);
    }
    machines.write("configs/teleoperation/robot.py", ROBOT);
    let file = "configs/experiments/teleoperation.toml";
    let text = with_policy(&Document::read(file).text).replace("episodes = 30", "episodes = 2");
    machines.write(file, &text.replace("episode_steps = 30", "episode_steps = 3"));
    let check =
        machines.on_edge("peernet run --check configs/experiments/teleoperation.toml", &[]).wait_for_end();
    assert_eq!(check.code(), 0, "{}", check.log);
    // The document shows this output.
    let document = Document::read("docs/experiments/teleoperation.md").text;
    assert!(document.contains(check.log.trim()), "{}", check.log);
    let end =
        wait_for_runs(machines.on_edge(ONE_NETWORK, &[("peernet run --only Network=LAN", PYTHON_RUN)]), 9);
    assert_eq!(end.code(), 0, "{}", end.log);
    let results = Results::of(machines.folder().join("results/teleoperation"));
    assert_eq!(results.states(), ["finished"; 9]);
    assert_eq!(column(&results.folder.join("compare.csv"), "success-rate"), ["1"; 9]);
    let end = machines.on_edge(NO_NETWORK, &[("peernet run", PYTHON_RUN)]).wait_for_end();
    assert_eq!(end.code(), 0, "the run without a network is finished already: {}", end.log);
    std::os::unix::fs::symlink(&results.folder, machines.folder().join("teleoperation")).expect("writable");

    let table = "peernet compare teleoperation --format latex --out table.tex";
    assert_eq!(machines.on_edge(table, &[]).wait_for_end().code(), 0);
    let table = std::fs::read_to_string(machines.folder().join("table.tex")).expect("it was written");
    assert!(table.contains("\\toprule") && table.matches("RTX 3090").count() >= 5, "{table}");
    // The experiment's own table is the same.
    let experiment_table =
        std::fs::read_to_string(results.folder.join("compare.tex")).expect("it was written");
    assert_eq!(table.trim_end(), experiment_table.trim_end());
    let first = format!("runs/{}", results.folders()[0]);
    let command = "peernet compare teleoperation --baseline teleoperation/run-1";
    let end = machines.on_edge(command, &[("run-1", &first)]).wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    let figures = "peernet plot teleoperation --kind stacked --out figures";
    let end = machines.on_edge(figures, &[]).wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    assert!(machines.folder().join("figures/stacked.svg").is_file(), "{}", end.log);
}

/// Measures the study of a link, with the file unchanged.
fn measure_payload_study(machines: &DocumentedCommands) {
    let file = "configs/experiments/payload-study.toml";
    machines.write(file, &Document::read(file).text);
    let end = wait_for_runs(machines.on_edge(PAYLOADS, &[("=100", "=10")]), 8);
    assert_eq!(end.code(), 0, "{}", end.log);
    let results = Results::of(machines.folder().join("results/payload-study"));
    assert_eq!(results.states(), ["finished"; 8]);
    assert_eq!(column(&results.folder.join("compare.csv"), "count"), ["10"; 8]);
    assert!(results.folder.join("payload-latency.svg").is_file(), "{}", end.log);
}
