//! The two machines of docs/two-machines.md with the files of this document: queries, calibration, maintenance.

use peernet_tests::network::Host;
use peernet_tests::truth::query_database;
use peernet_tests::{Document, DocumentedCommands, ProcessEnd, wait_until};
use serde_json::Value;

use crate::experiments::{Results, column};

pub(crate) const COMMANDS: [&str; 20] = [
    "peernetd check /etc/peernet/agent.toml",
    "peernetd check FILE",
    "peernetd check FILE…",
    "peernetd run FILE",
    "peernet status",
    "curl http://127.0.0.1:8040/api/v1/pipelines",
    "curl http://127.0.0.1:8040/api/v1/runs",
    "curl -N http://127.0.0.1:8040/api/v1/live",
    "curl http://127.0.0.1:8040/api/openapi.json",
    "peernet calibrate tcp://10.0.0.2:5551",
    "peernet calibrate 10.0.0.2",
    "peernet calibrate PEER",
    "peernet recompute 12",
    PLACEMENTS,
    "peernetd doctor --config /etc/peernet/aggregator.toml",
    "peernetd doctor --config /etc/peernet/agent.toml",
    BACKUP,
    REBUILD,
    REPAIR,
    CLEAR,
];

const PLACEMENTS: &str = "peernet run --only Where=local --only Where=cloud --set pipeline.placement.peer=tcp://10.0.0.2:5551 /usr/share/doc/peernet/examples/experiments/demo.toml";
const BACKUP: &str =
    "peernetd backup --config /etc/peernet/aggregator.toml /backup/peernet-$(date +%F).sqlite";
const REPAIR: &str = "peernetd doctor --repair --config /etc/peernet/aggregator.toml";
const REBUILD: &str = "peernetd rebuild-rollups --config /etc/peernet/aggregator.toml [--run NUMBER]";
const CLEAR: &str = "peernetd clear-host-secret --config /etc/peernet/aggregator.toml robot";

/// Arguments of a calibration of some seconds.
const SHORT_CALIBRATION: &str = "calibrate --sizes 100,1kB,10kB --repeats 20 --quiet";

/// Installs the three files of docs/two-machines.md on the machines that it names, which share one clock here.
pub(crate) fn install(machines: &DocumentedCommands) {
    let document = Document::read("docs/two-machines.md");
    // The files are blocks of a numbered list and indented by seven spaces.
    let files = document.indented_blocks("put-it-on-two-machines", 7);
    let [aggregator, cloud, robot, ..] = &*files else { panic!("it has three files: {files:#?}") };
    let agent = |clock: &str| {
        format!("[agent]\nstate_dir = \"/var/lib/peernet/agent\"\nclock_identity = \"{clock}\"")
    };
    machines.install(machines.cloud(), "/etc/peernet/aggregator.toml", aggregator, &[]);
    let models_folder = ("/usr/share/peernet/models", "models");
    machines.install(
        machines.cloud(),
        "/etc/peernet/agent.toml",
        cloud,
        &[("[agent]", &agent("cloud")), models_folder],
    );
    let pictures_folder = ("/var/lib/peernet/pictures", "models/quality-control/pictures");
    machines.install(
        machines.edge(),
        "/etc/peernet/agent.toml",
        robot,
        &[("[agent]", &agent("robot")), pictures_folder],
    );
}

fn assert_success(end: ProcessEnd) -> String {
    assert_eq!(end.code(), 0, "{}", end.log);
    end.log
}

/// Returns the JSON document that curl received.
fn json(end: ProcessEnd) -> Value {
    let log = assert_success(end);
    let line = log.lines().find_map(|line| serde_json::from_str(line).ok());
    line.unwrap_or_else(|| panic!("no document: {log}"))
}

#[test]
fn documented_commands_work_on_two_machines() {
    let machines = DocumentedCommands::new(&COMMANDS);
    install(&machines);
    let (edge, cloud) = (machines.edge(), machines.cloud());
    let config = |name: &str| format!("/etc/peernet/{name}.toml");
    for host in [edge, cloud] {
        assert_success(
            machines.execute_on(host, "peernetd check /etc/peernet/agent.toml", &[]).wait_for_end(),
        );
    }
    assert_success(
        machines.on_cloud("peernetd check FILE", &[("FILE", &config("aggregator"))]).wait_for_end(),
    );
    let files = format!("{} {}", config("aggregator"), config("agent"));
    assert_success(machines.on_cloud("peernetd check FILE…", &[("FILE…", &files)]).wait_for_end());

    let run =
        |host: &Host, name: &str| machines.execute_on(host, "peernetd run FILE", &[("FILE", &config(name))]);
    let (edge_agent, cloud_agent, aggregator) =
        (run(edge, "agent"), run(cloud, "agent"), run(cloud, "aggregator"));
    aggregator.wait_for("ready");
    wait_until("the robot's pipeline on the dashboard", || {
        let status = machines.on_cloud("peernet status", &[]).wait_for_end();
        let expected = ["robot", "inspection", "quality-control", "cloud"];
        (status.code() == 0 && expected.iter().all(|word| status.log.contains(word))).then_some(())
    });
    request_documented_paths(&machines);
    calibrate(&machines);

    assert_success(
        machines.on_cloud("peernetd doctor --config /etc/peernet/aggregator.toml", &[]).wait_for_end(),
    );
    assert_eq!(edge_agent.stop().code(), 0);
    let spool = assert_success(
        machines.on_edge("peernetd doctor --config /etc/peernet/agent.toml", &[]).wait_for_end(),
    );
    assert!(spool.contains("stream"), "{spool}");
    compare_placements(&machines);
    let recomputed = assert_success(machines.on_cloud("peernet recompute 12", &[("12", "1")]).wait_for_end());
    assert!(recomputed.contains("upload") && recomputed.contains("download"), "{recomputed}");
    back_up_and_rebuild(&machines, || assert_eq!(aggregator.stop().code(), 0));
    assert_eq!(cloud_agent.stop().code(), 0);
    machines.finish();
}

/// Executes the queries of the README's section "Use it".
fn request_documented_paths(machines: &DocumentedCommands) {
    let get = |path: &str| {
        json(machines.on_cloud(&format!("curl http://127.0.0.1:8040/api/{path}"), &[]).wait_for_end())
    };
    let pipelines = get("v1/pipelines");
    assert_eq!(
        (&pipelines["pipelines"][0]["host"], &pipelines["pipelines"][0]["name"]),
        (&"robot".into(), &"inspection".into())
    );
    // Live values are available before the run is stored.
    let run = wait_until("the run in the store", || get("v1/runs")["runs"].get(0).cloned());
    assert_eq!(run["host"], "robot");
    assert!(get("openapi.json")["paths"].is_object());
    let live = machines.on_cloud("curl -N http://127.0.0.1:8040/api/v1/live", &[]);
    live.wait_for("data:");
    live.kill();
}

/// Calibrates the link with each documented form of the peer, while the pipeline uses the link as well.
fn calibrate(machines: &DocumentedCommands) {
    for (command, changes) in [
        ("peernet calibrate tcp://10.0.0.2:5551", ("tcp", "--result-loc first tcp")),
        ("peernet calibrate PEER", ("PEER", "--result-loc second 10.0.0.2:5551")),
        ("peernet calibrate 10.0.0.2", ("10.0.0.2", "--result-loc third 10.0.0.2")),
    ] {
        assert_success(
            machines.on_edge(command, &[changes, ("calibrate", SHORT_CALIBRATION)]).wait_for_end(),
        );
    }
    for folder in ["first", "second", "third"] {
        let study = std::fs::read(machines.folder().join(folder).join("calibration.json")).expect("written");
        let study: Value = serde_json::from_slice(&study).expect("it is JSON");
        assert_eq!((&study["setting"]["cloud"], &study["counts"]["failed"]), (&"cloud".into(), &0.into()));
    }
}

/// Measures the experiment of the package on the robot, whose agent has stopped, against the model on the cloud.
fn compare_placements(machines: &DocumentedCommands) {
    let experiment = Document::read("configs/experiments/demo.toml").text;
    machines.write("demo.toml", &experiment.replace("episodes = 4", "episodes = 2").replace("= 25", "= 6"));
    let file = ("/usr/share/doc/peernet/examples/experiments/demo.toml", "demo.toml");
    let log = assert_success(machines.on_edge(PLACEMENTS, &[file]).wait_for_end());
    assert!(log.contains("total (measured)"), "{log}");
    let results = Results::of(machines.folder().join("results/demo"));
    assert_eq!(results.states().iter().filter(|state| *state == "finished").count(), 6);
    assert_eq!(column(&results.folder.join("compare.csv"), "Where"), ["local", "cloud", "cloud"]);
}

/// Makes a backup while the database is written to, and rebuilds roll-ups after `stop_aggregator`.
fn back_up_and_rebuild(machines: &DocumentedCommands, stop_aggregator: impl FnOnce()) {
    std::fs::create_dir_all(machines.folder().join("cloud/backup")).expect("writable");
    assert_success(machines.on_cloud(BACKUP, &[]).wait_for_end());
    let backups = std::fs::read_dir(machines.folder().join("cloud/backup")).expect("the backup was made");
    let backups: Vec<_> = backups.map(|entry| entry.expect("it can be listed").path()).collect();
    let [backup] = &*backups else { panic!("one copy under the day's name: {backups:?}") };
    assert_eq!(query_database(backup, "SELECT count(*) FROM run").trim(), "1");

    let cleared = assert_success(machines.on_cloud(CLEAR, &[]).wait_for_end());
    assert!(cleared.contains("deleted the secret of robot"), "{cleared}");

    let rebuild = |run: &str| machines.on_cloud(REBUILD, &[("[--run NUMBER]", run)]).wait_for_end();
    assert_eq!(rebuild("").code(), 69, "a rebuild beside a running aggregator is refused");
    stop_aggregator();
    let database = machines.folder().join("cloud/var/lib/peernet/aggregator/peernet.sqlite");
    // The resolution 0 is the whole run.
    let rolled_up_values =
        || query_database(&database, "SELECT sum(count) FROM rollup WHERE resolution_s = 0");
    let before = rolled_up_values();
    assert_success(rebuild(""));
    assert_success(rebuild("--run 1"));
    assert_eq!(rolled_up_values(), before);
    assert_success(machines.on_cloud(REPAIR, &[]).wait_for_end());
    assert_eq!(rolled_up_values(), before, "a repair changes an undamaged database");
}
