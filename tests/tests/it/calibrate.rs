//! `peernet calibrate` against a host whose clock is a second ahead, and `peernet recompute` of a stored run.

use peernet_tests::{Ended, Process, Site, program};
use rustix::process::Signal;
use serde_json::Value;

/// Another clock than that of `peernet`: a second ahead, under a name of its own.
const CLOUD: &str = r#"
[agent]
name = "cloud"
state_dir = "{folder}/cloud"

[rehearsal]
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
[agent]
name = "edge"
state_dir = "{folder}/edge"
aggregator = "tcp://127.0.0.1:{events}"

[[pipeline]]
name = "offload"
sensor = { kind = "synthetic", size_bytes = 1000 }
placement = { kind = "remote", peer = "tcp://127.0.0.1:{data}", model = "echo" }
load = { mode = "rate", hz = 50.0 }
limit = { iterations = 100 }
"#;

/// Files of a calibration.
const FILES: [&str; 7] = [
    "samples.csv",
    "summary.csv",
    "calibration.json",
    "latency.png",
    "latency.svg",
    "throughput.png",
    "throughput.svg",
];

struct Plant {
    site: Site,
    peer: String,
}

impl Plant {
    fn new() -> Self {
        let site = Site::new();
        let peer = format!("127.0.0.1:{}", site.data);
        Self { site, peer }
    }

    fn start(&self, name: &str, file: &str) -> Process {
        self.site.write(name, file);
        let process = self.site.start(name);
        process.wait_for("ready");
        process
    }

    fn peernet(&self, arguments: &[&str]) -> Process {
        Process::start(&program("peernet"), arguments, self.site.folder(), &[])
    }

    fn calibrate(&self, arguments: &[&str]) -> Ended {
        self.peernet(&[&["calibrate", &self.peer, "--result-loc", "results"], arguments].concat()).ended()
    }

    fn results(&self) -> Value {
        let file = self.site.folder().join("results/calibration.json");
        serde_json::from_slice(&std::fs::read(file).expect("it was written")).expect("it is JSON")
    }
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

#[test]
fn a_link_is_calibrated_whatever_the_clocks_show() {
    let plant = Plant::new();
    let _cloud = plant.start("cloud.toml", CLOUD);
    let sweep = ["--sizes", "100,1kB,10kB,100kB,1MB", "--repeats", "60", "--seconds", "50"];
    let done = plant.calibrate(&sweep);
    assert_eq!(done.code(), 0, "{}", done.log);
    assert!(done.log.contains("the intercepts, ") && done.log.contains("clock bounds"), "{}", done.log);

    let study = plant.results();
    assert_eq!(study["counts"], serde_json::json!({ "measured": 300, "warm_up": 10, "failed": 0 }));
    assert_eq!((&study["setting"]["cloud"], &study["setting"]["rehearsed"]), (&"cloud".into(), &true.into()));
    for (direction, ahead) in [("up", 1.0), ("down", -1.0)] {
        let direction = &study[direction];
        // Both hosts read one kernel's clock: without the rehearsed second the raw stamps are the truth.
        let over_samples =
            |path: &str| number(&direction["fits"].pointer(path).expect("a fit")["intercept"]["value"]);
        let (reported, raw) = (over_samples("/samples/least_squares"), over_samples("/raw"));
        assert!(
            (raw - ahead).abs() < 0.5,
            "the published way sees the clocks' offset, {ahead} s, not {raw} s"
        );
        let (error, claimed) = ((reported - (raw - ahead)).abs(), &direction["claimed"]["bounds"]);
        let allowed = number(&claimed[1]) - number(&claimed[0]);
        assert!(
            error < 1e-3 && error <= allowed,
            "the intercept is wrong by {error} s, claimed are {allowed} s"
        );
    }
    // Which of them depends on how busy the machine is; a verdict about the clocks would be wrong.
    let verdict = study["verdict"]["kind"].as_str().expect("there is a verdict");
    assert!(["trusted", "inconclusive", "contradicted"].contains(&verdict), "{}", study["verdict"]);
    let offset = number(&study["clocks"]["offset"]);
    assert!((offset - 1.0).abs() < 1e-3, "the cloud is 1 s ahead, not {offset} s");

    let folder = plant.site.folder().join("results");
    assert!(FILES.iter().all(|name| folder.join(name).is_file()), "{folder:?}");
    for name in ["latency.png", "throughput.png"] {
        let picture = image::open(folder.join(name)).expect("a picture");
        assert!(picture.width() >= 1000 && picture.height() >= 600, "{name}");
    }
    let samples = std::fs::read_to_string(folder.join("samples.csv")).expect("it was written");
    assert_eq!(samples.lines().count(), 311);
    every_delay_lies_within_its_bounds(&samples);

    let again = plant.calibrate(&sweep);
    assert_eq!(again.code(), 64, "{}", again.log);
    assert!(again.log.contains("--overwrite"), "{}", again.log);
}

/// Of every iteration, warm-up included: raw less the rehearsed second is the truth.
fn every_delay_lies_within_its_bounds(samples: &str) {
    let mut rows = samples.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let header = rows.next().expect("there is a header");
    for row in rows {
        let cell = |name: String| {
            let at = header.iter().position(|column| *column == name).expect("the column is there");
            row[at].parse::<f64>().unwrap_or_else(|error| panic!("{name}: {error} in {row:?}"))
        };
        for (stage, ahead) in [("upload", 1.0), ("download", -1.0)] {
            let [raw, lo, hi] = ["raw", "lo", "hi"].map(|column| cell(format!("{stage}-{column}")));
            let truth = raw - ahead;
            assert!((lo..=hi).contains(&truth), "{stage}: {truth} s lies outside of {lo} to {hi} in {row:?}");
        }
    }
}

#[test]
fn what_was_measured_until_ctrl_c_is_written() {
    let plant = Plant::new();
    let _cloud = plant.start("cloud.toml", CLOUD);
    let arguments =
        ["calibrate", &plant.peer, "--result-loc", "results", "--repeats", "1000000", "--seconds", "600"];
    let running = plant.peernet(&arguments);
    running.wait_for("s left");
    running.signal(Signal::INT);
    let ended = running.ended();
    assert_eq!(ended.code(), 130, "{}", ended.log);
    let study = plant.results();
    assert_eq!(study["setting"]["interrupted"], true);
    assert!(number(&study["counts"]["measured"]) > 0.0, "{}", study["counts"]);
    assert!(FILES.iter().all(|name| plant.site.folder().join("results").join(name).is_file()));
}

#[test]
fn who_cannot_be_calibrated_is_told_why() {
    let plant = Plant::new();
    let nobody = plant.calibrate(&[]);
    assert_eq!(nobody.code(), 69, "{}", nobody.log);
    assert!(nobody.log.contains(&plant.peer), "{}", nobody.log);
    let few = plant.calibrate(&["--sizes", "100,1kB"]);
    assert_eq!(few.code(), 64, "{}", few.log);

    let closed = CLOUD.replace("[serve]", "[serve]\ncalibration = false");
    let _cloud = plant.start("closed.toml", &closed);
    let refused = plant.calibrate(&[]);
    assert_eq!(refused.code(), 69, "{}", refused.log);
    assert!(refused.log.contains("[serve] calibration = true"), "{}", refused.log);
    assert!(!plant.site.folder().join("results").exists(), "there is nothing to keep");

    let wrong = plant.site.write("wrong.toml", "[agent]\n[clock]\nmax_drift = 3\n");
    let wrong = plant.calibrate(&["--config", &wrong.display().to_string()]);
    assert_eq!(wrong.code(), 78, "{}", wrong.log);
    assert!(wrong.log.contains("max_drift"), "{}", wrong.log);
}

#[test]
fn a_stored_run_is_computed_again_and_left_as_it_was() {
    let plant = Plant::new();
    let (_aggregator, api) = plant.site.aggregator();
    let _cloud = plant.start("cloud.toml", CLOUD);
    let edge = plant.start("edge.toml", EDGE);
    let run = api.until("/api/v1/runs", |list| {
        let run = &list["runs"][0];
        (run["reason"] == "finished").then(|| run["number"].as_i64()).flatten()
    });
    // With all that was learnt of the clocks, also after the run.
    assert_eq!(edge.stop().code(), 0);
    let before = api.json(&format!("/api/v1/runs/{run}/stages"));

    let url = format!("http://127.0.0.1:{}", plant.site.http);
    let number = run.to_string();
    let shown = plant.peernet(&["recompute", &number, "--url", &url]).ended();
    assert_eq!(shown.code(), 0, "{}", shown.log);
    for part in ["upload", "download", "before", "after", "nothing stored was changed"] {
        assert!(shown.log.contains(part), "{part} is missing in\n{}", shown.log);
    }
    let json = plant.peernet(&["recompute", &number, "--url", &url, "--json"]).ended();
    let json: Value = serde_json::from_str(&json.log).unwrap_or_else(|error| panic!("{error}: {}", json.log));
    for stage in json["stages"].as_array().expect("a list") {
        let after = &stage["after"];
        assert_eq!(after["delay"]["count"], stage["before"]["delay"]["count"], "{stage:#}");
        let half_width = |judgement: &Value| self::number(&judgement["half_width"]["mean"]);
        assert!(
            half_width(after) <= half_width(&stage["before"]) * 1.001,
            "more is known afterwards: {stage:#}"
        );
    }
    assert_eq!(before, api.json(&format!("/api/v1/runs/{run}/stages")));

    let unknown = plant.peernet(&["recompute", "4711", "--url", &url]).ended();
    assert_eq!(unknown.code(), 69, "{}", unknown.log);
    assert!(unknown.log.contains("4711"), "{}", unknown.log);
}
