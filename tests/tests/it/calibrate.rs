//! Tests of `peernet calibrate` against a host whose clock is a second ahead, of
//! `peernet recompute` with a stored run, and of programs whose output is closed.

use std::process::{Command, Stdio};

use peernet_tests::{AGGREGATOR, Api, LoopbackDeployment, Process, ProcessEnd, program, wait_until};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

/// Cloud whose clock differs from that of `peernet`: a second ahead, with another clock identity.
/// Port 0 of `[probes]` means any free port.
const CLOUD: &str = r#"
[agent]
name = "cloud"
state_dir = "{folder}/cloud"

[clock_fault]
offset_ms = 1000

[probes]
port = 0

[serve]
listen = "tcp://127.0.0.1:{data}"

[[model]]
name = "echo"
kind = "echo"
"#;

const EDGE: &str = r#"
[clock_fault]
offset_ms = -500

[[pipeline]]
name = "offload"
sensor = { kind = "synthetic", size_bytes = 1000 }
placement = { kind = "remote", peer = "tcp://127.0.0.1:{data}", model = "echo" }
load = { mode = "rate", hz = 50.0 }
limit = { iterations = 100 }
"#;

/// Files of a calibration.
const FILES: [&str; 11] = [
    "samples.csv",
    "summary.csv",
    "calibration.json",
    "latency.png",
    "latency.svg",
    "latency.pdf",
    "latency-caption.txt",
    "throughput.png",
    "throughput.svg",
    "throughput.pdf",
    "throughput-caption.txt",
];

/// Folder of the hosts' files, and the address of the cloud that is calibrated.
struct CalibratedHosts {
    deployment: LoopbackDeployment,
    peer: String,
}

impl CalibratedHosts {
    fn new() -> Self {
        let deployment = LoopbackDeployment::new();
        let peer = format!("127.0.0.1:{}", deployment.data_port);
        Self { deployment, peer }
    }

    fn start(&self, name: &str, file: &str) -> Process {
        self.deployment.write(name, file);
        let process = self.deployment.start(name);
        process.wait_for("ready");
        process
    }

    fn peernet(&self, arguments: &[&str]) -> Process {
        Process::start(&program("peernet"), arguments, self.deployment.folder(), &[])
    }

    fn calibrate(&self, arguments: &[&str]) -> ProcessEnd {
        self.peernet(&[&["calibrate", &self.peer, "--result-loc", "results"], arguments].concat())
            .wait_for_end()
    }

    /// Starts a calibration that runs until it is interrupted.
    fn start_endless_calibration(&self) -> Process {
        let arguments = ["--sizes", "100,1kB,10kB", "--repeats", "1000000", "--seconds", "600"];
        let running =
            self.peernet(&[&["calibrate", &self.peer, "--result-loc", "results"], &arguments[..]].concat());
        // A line of progress ends with the time that is left.
        running.wait_for(" left");
        running
    }

    fn results(&self) -> Value {
        let file = self.deployment.folder().join("results/calibration.json");
        serde_json::from_slice(&std::fs::read(file).expect("it was written")).expect("it is JSON")
    }
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

#[test]
fn calibration_is_right_despite_clock_errors() {
    let hosts = CalibratedHosts::new();
    let _cloud = hosts.start("cloud.toml", CLOUD);
    let sweep = ["--sizes", "100,1kB,10kB,100kB,1MB", "--repeats", "60", "--seconds", "50"];
    let first = hosts.calibrate(&sweep);
    assert_eq!(first.code(), 0, "{}", first.log);
    assert!(first.log.contains("the intercepts, ") && first.log.contains("clock bounds"), "{}", first.log);

    let study = hosts.results();
    assert_eq!(study["counts"], serde_json::json!({ "measured": 300, "warm_up": 10, "failed": 0 }));
    // `rehearsed` is `true` if faults are injected into a clock.
    assert_eq!((&study["setting"]["cloud"], &study["setting"]["rehearsed"]), (&"cloud".into(), &true.into()));
    for (direction, ahead) in [("up", 1.0), ("down", -1.0)] {
        let direction = &study[direction];
        // Both hosts read the same kernel's clock, so the raw stamps without the injected second are the truth.
        let intercept =
            |path: &str| number(&direction["fits"].pointer(path).expect("a fit")["intercept"]["value"]);
        let (reported, raw) = (intercept("/samples/least_squares"), intercept("/raw"));
        assert!(
            (raw - ahead).abs() < 0.5,
            "the intercept of the raw delays is {raw} s, and not the clocks' offset, {ahead} s"
        );
        let (error, claimed) = ((reported - (raw - ahead)).abs(), &direction["claimed"]["bounds"]);
        let allowed = number(&claimed[1]) - number(&claimed[0]);
        assert!(
            error < 1e-3 && error <= allowed,
            "the intercept is wrong by {error} s, and the claimed interval is {allowed} s wide"
        );
    }
    // The verdict depends on the load of the machine; a verdict about the clocks would be wrong.
    let verdict = study["verdict"]["kind"].as_str().expect("there is a verdict");
    assert!(["trusted", "inconclusive", "contradicted"].contains(&verdict), "{}", study["verdict"]);
    let offset = number(&study["clocks"]["offset"]);
    assert!((offset - 1.0).abs() < 1e-3, "the cloud is 1 s ahead, not {offset} s");

    let folder = hosts.deployment.folder().join("results");
    assert!(FILES.iter().all(|name| folder.join(name).is_file()), "{folder:?}");
    for name in ["latency.png", "throughput.png"] {
        let picture = image::open(folder.join(name)).expect("a picture");
        assert!(picture.width() >= 1000 && picture.height() >= 600, "{name}");
    }
    let samples = std::fs::read_to_string(folder.join("samples.csv")).expect("it was written");
    // The header, 300 measured payloads and 10 payloads of the warm-up.
    assert_eq!(samples.lines().count(), 311);
    assert_delays_within_bounds(&samples);

    let second = hosts.calibrate(&sweep);
    assert_eq!(second.code(), 64, "{}", second.log);
    assert!(second.log.contains("--overwrite"), "{}", second.log);
}

/// Checks that the interval of every answered iteration, warm-up included, contains the truth. The truth is the raw delay
/// minus the injected second.
fn assert_delays_within_bounds(samples: &str) {
    let mut rows = samples.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let header = rows.next().expect("there is a header");
    let outcome = header.iter().position(|column| *column == "outcome").expect("the column is there");
    let answered: Vec<_> = rows.filter(|row| row[outcome] == "ok").collect();
    assert!(!answered.is_empty(), "no payload was answered:\n{samples}");
    for row in answered {
        let cell = |name: String| {
            let index = header.iter().position(|column| *column == name).expect("the column is there");
            row[index].parse::<f64>().unwrap_or_else(|error| panic!("{name}: {error} in {row:?}"))
        };
        for (stage, ahead) in [("upload", 1.0), ("download", -1.0)] {
            let [raw, lo, hi] = ["raw", "lo", "hi"].map(|column| cell(format!("{stage}-{column}")));
            let truth = raw - ahead;
            // The interval is for the free-running clocks, the raw difference for the wall clocks.
            // A host reads its wall clock at most 3 µs after its free-running clock; a slower
            // reading is repeated.
            const MAX_READ_DISTANCE: f64 = 3e-6;
            assert!(
                (lo - MAX_READ_DISTANCE..=hi + MAX_READ_DISTANCE).contains(&truth),
                "{stage}: {truth} s lies outside of {lo} to {hi} in {row:?}"
            );
        }
    }
}

#[test]
fn ctrl_c_writes_partial_calibration() {
    let hosts = CalibratedHosts::new();
    let _cloud = hosts.start("cloud.toml", CLOUD);
    let arguments =
        ["calibrate", &hosts.peer, "--result-loc", "results", "--repeats", "1000000", "--seconds", "600"];
    let running = hosts.peernet(&arguments);
    running.wait_for(" left");
    running.signal(Signal::INT);
    let end = running.wait_for_end();
    assert_eq!(end.code(), 130, "{}", end.log);
    let study = hosts.results();
    assert_eq!(study["setting"]["interrupted"], true);
    assert!(number(&study["counts"]["measured"]) > 0.0, "{}", study["counts"]);
    assert!(FILES.iter().all(|name| hosts.deployment.folder().join("results").join(name).is_file()));
}

#[test]
fn unsuitable_peer_is_refused_with_reason() {
    let hosts = CalibratedHosts::new();
    let without_peer = hosts.calibrate(&[]);
    assert_eq!(without_peer.code(), 69, "{}", without_peer.log);
    assert!(without_peer.log.contains(&hosts.peer), "{}", without_peer.log);
    let too_few_sizes = hosts.calibrate(&["--sizes", "100,1kB"]);
    assert_eq!(too_few_sizes.code(), 64, "{}", too_few_sizes.log);
    let no_repeats = hosts.calibrate(&["--repeats", "0"]);
    assert_eq!(no_repeats.code(), 64, "{}", no_repeats.log);
    assert!(no_repeats.log.contains("at least 1"), "{}", no_repeats.log);

    let closed = CLOUD.replace("[serve]", "[serve]\ncalibration = false");
    let _cloud = hosts.start("closed.toml", &closed);
    let refused = hosts.calibrate(&[]);
    assert_eq!(refused.code(), 69, "{}", refused.log);
    assert!(refused.log.contains("[serve] calibration = true"), "{}", refused.log);
    assert!(!hosts.deployment.folder().join("results").exists(), "a refused calibration creates no folder");

    let file = hosts.deployment.write("wrong.toml", "[agent]\n[clock]\nmax_drift = 3\n");
    let invalid = hosts.calibrate(&["--config", &file.display().to_string()]);
    assert_eq!(invalid.code(), 78, "{}", invalid.log);
    assert!(invalid.log.contains("max_drift"), "{}", invalid.log);
}

#[test]
fn foreign_port_is_distinguished_from_slow_peer() {
    let hosts = CalibratedHosts::new();
    let (_aggregator, _) = hosts.deployment.start_aggregator();
    let peer = format!("tcp://127.0.0.1:{}", hosts.deployment.events_port);
    let calibration = hosts.peernet(&["calibrate", &peer, "--result-loc", "results"]).wait_for_end();
    assert_eq!(calibration.code(), 69, "{}", calibration.log);
    let message = format!("something listens at {peer} but does not answer like an agent's [serve]");
    assert!(
        calibration.log.contains(&message) && calibration.log.contains("port of an aggregator"),
        "{}",
        calibration.log
    );
    assert!(
        !calibration.log.contains("open_timeout_ms"),
        "the timeout is not the cause: {}",
        calibration.log
    );
}

#[test]
fn calibration_size_beyond_peer_limit_is_refused() {
    let hosts = CalibratedHosts::new();
    let _cloud = hosts.start("cloud.toml", CLOUD);
    let calibration = hosts.calibrate(&["--sizes", "1,2kB,100MB"]);
    assert_eq!(calibration.code(), 69, "{}", calibration.log);
    for part in ["payloads of 100 MB", "max_message_bytes", "67108864", "--sizes"] {
        assert!(calibration.log.contains(part), "{part} is missing in\n{}", calibration.log);
    }
    assert!(!hosts.deployment.folder().join("results").exists(), "a refused calibration creates no folder");
}

#[test]
fn bounds_are_exact_on_one_clock() {
    let hosts = CalibratedHosts::new();
    let _cloud = hosts.start("cloud.toml", &CLOUD.replace("[clock_fault]\noffset_ms = 1000\n", ""));
    let calibration = hosts.calibrate(&["--sizes", "100,1kB,10kB", "--repeats", "20"]);
    assert_eq!(calibration.code(), 0, "{}", calibration.log);
    assert_eq!(hosts.results()["verdict"]["kind"], "exact");
    let exact_lines = calibration.log.lines().filter(|line| line.contains(" exact")).count();
    // Three sizes, the clock bounds in both directions, and the verdict.
    assert_eq!(exact_lines, 6, "{}", calibration.log);
}

#[test]
fn peer_with_new_clock_ends_the_calibration() {
    let hosts = CalibratedHosts::new();
    let cloud = hosts.start("cloud.toml", CLOUD);
    let running = hosts.start_endless_calibration();
    cloud.kill();
    running.wait_for("cloud is away");
    let _other = hosts.start("other.toml", &CLOUD.replace("offset_ms = 1000", "offset_ms = 300"));
    let end = running.wait_for_end();
    assert_eq!(end.code(), 69, "{}", end.log);
    for part in ["returned with another clock", "made wrong on purpose (offset +300 ms)"] {
        assert!(end.log.contains(part), "{part} is missing in\n{}", end.log);
    }
    let study = hosts.results();
    assert_eq!(
        (&study["setting"]["interrupted"], &study["setting"]["rehearsed"]),
        (&true.into(), &true.into())
    );
    let reason = study["setting"]["ended"].as_str().expect("the reason is stated");
    assert!(reason.contains("another clock"), "{reason}");
    assert_eq!(study["clocks"]["steps"], 0);
    // The study contains no data of the second clock.
    let offset = number(&study["clocks"]["offset"]);
    assert!((offset - 1.0).abs() < 1e-3, "the clock of the study is 1 s ahead, not {offset} s");
    let samples =
        std::fs::read_to_string(hosts.deployment.folder().join("results/samples.csv")).expect("written");
    assert_delays_within_bounds(&samples);
}

#[test]
fn calibration_reports_interruption_of_peer() {
    let hosts = CalibratedHosts::new();
    // The cloud gives the system's clock another identity than `peernet` does, so that exchanges relate the two clocks.
    // The identity stays the same when the cloud restarts.
    let configuration = CLOUD
        .replace("[clock_fault]\noffset_ms = 1000\n", "")
        .replace("[probes]", "clock_identity = \"cloud\"\n\n[probes]");
    let cloud = hosts.start("cloud.toml", &configuration);
    let running = hosts.start_endless_calibration();
    // The cloud is suspended before it is killed, so that a payload is certainly lost.
    cloud.signal(Signal::STOP);
    running.wait_for("cloud is away");
    cloud.kill();
    let lines = running.log().matches(" left").count();
    let _restarted = hosts.start("cloud.toml", &configuration);
    running.wait_for_nth(" left", lines + 1);
    running.signal(Signal::INT);
    let end = running.wait_for_end();
    assert_eq!(end.code(), 130, "{}", end.log);
    assert!(end.log.contains("the peer went away once during the study and came back"), "{}", end.log);
    let study = hosts.results();
    assert_eq!((&study["setting"]["reconnections"], &study["clocks"]["steps"]), (&1.into(), &0.into()));
    let lost = &study["failures"][0];
    assert_eq!(lost["outcome"], "lost", "{study:#}");
    assert!(lost["commonest_reason"].as_str().is_some_and(|reason| !reason.is_empty()), "{lost}");
    assert!(end.log.contains("payloads were not answered: "), "{}", end.log);
}

#[test]
fn closed_output_causes_no_panic() {
    let deployment = LoopbackDeployment::new();
    let start = |name: &str, arguments: &[&str]| {
        let mut program = Command::new(program(name));
        let program = program.args(arguments).current_dir(deployment.folder());
        program.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts")
    };
    deployment.write("aggregator.toml", AGGREGATOR);
    let mut daemon = start("peernetd", &["run", "aggregator.toml"]);
    drop((daemon.stdout.take(), daemon.stderr.take()));
    let api = Api::on_port(deployment.http_port);
    wait_until("the dashboard", || api.get("/healthz").filter(|(status, _)| *status == 200));

    let url = format!("http://127.0.0.1:{}", deployment.http_port);
    let mut status = start("peernet", &["status", "--url", &url]);
    drop(status.stdout.take());
    let status = status.wait_with_output().expect("it ends");
    let errors = String::from_utf8_lossy(&status.stderr);
    assert_eq!((status.status.code(), errors.as_ref()), (Some(0), ""));

    let pid = i32::try_from(daemon.id()).ok().and_then(Pid::from_raw).expect("a child has a pid");
    kill_process(pid, Signal::TERM).expect("it runs");
    assert_eq!(daemon.wait().expect("it ends").code(), Some(0));
}

#[test]
fn recompute_leaves_stored_run_unchanged() {
    let hosts = CalibratedHosts::new();
    let (_aggregator, api) = hosts.deployment.start_aggregator();
    let _cloud = hosts.start("cloud.toml", CLOUD);
    let edge = hosts.deployment.start_agent("edge", EDGE);
    let run = api.wait_for_finished_run();
    let url = format!("http://127.0.0.1:{}", hosts.deployment.http_port);
    let status = hosts.peernet(&["status", "--url", &url]).wait_for_end();
    assert_eq!(status.code(), 0, "{}", status.log);
    for part in ["connected, clock fault", "CLOCK FAULT INJECTION: edge's clock", "offset -500 ms"] {
        assert!(status.log.contains(part), "{part} is missing in\n{}", status.log);
    }
    // When the edge has stopped, the stored clock relation also contains what was learnt after the run.
    assert_eq!(edge.stop().code(), 0);
    let before = api.json(&format!("/api/v1/runs/{run}/stages"));

    let run_number = run.to_string();
    let recomputed = hosts.peernet(&["recompute", &run_number, "--url", &url]).wait_for_end();
    assert_eq!(recomputed.code(), 0, "{}", recomputed.log);
    let faults = "wrong on purpose: cloud's (offset +1000 ms), the edge's (offset -500 ms)";
    for part in ["upload", "download", "before", "after", "nothing stored was changed", faults] {
        assert!(recomputed.log.contains(part), "{part} is missing in\n{}", recomputed.log);
    }
    let json = hosts.peernet(&["recompute", &run_number, "--url", &url, "--json"]).wait_for_end();
    let json: Value = serde_json::from_str(&json.log).unwrap_or_else(|error| panic!("{error}: {}", json.log));
    let stages = json["stages"].as_array().expect("a list");
    let names: Vec<&Value> = stages.iter().map(|stage| &stage["stage"]).collect();
    assert_eq!(names, ["upload", "download"], "{json:#}");
    for stage in stages {
        let after = &stage["after"];
        assert_eq!(after["delay"]["count"], stage["before"]["delay"]["count"], "{stage:#}");
        let half_width = |judgement: &Value| number(&judgement["half_width"]["mean"]);
        assert!(
            half_width(after) <= half_width(&stage["before"]) * 1.001,
            "later clock samples widen the interval: {stage:#}"
        );
    }
    assert_eq!(before, api.json(&format!("/api/v1/runs/{run}/stages")));

    let unknown_run = hosts.peernet(&["recompute", "4711", "--url", &url]).wait_for_end();
    assert_eq!(unknown_run.code(), 69, "{}", unknown_run.log);
    assert!(unknown_run.log.contains("4711"), "{}", unknown_run.log);
}
