//! Results that look like those of robots, with late messages, answers of two typical lengths, a slow start and lost
//! messages.

use peernet_analysis::loaded::Loaded;
use peernet_analysis::record::{HostRecord, ModelRecord, Placement, RunRecord};
use peernet_analysis::rows::{Column, Outcome, Row, Rows};
use peernet_statistics::SplitMix64;
use peernet_stream::ExperimentPosition;

/// Payload of an upload: a picture of 224 × 224 pixels with three bytes each.
const PICTURE_BYTES: f64 = 150_528.0;
/// Bytes of a message in addition to its payload.
const METADATA_BYTES: f64 = 120.0;

/// Random numbers with a fixed seed, so that every run of the benchmark has the same numbers.
pub(crate) struct TestRng(SplitMix64);

impl TestRng {
    const fn new(seed: u64) -> Self {
        Self(SplitMix64::new(seed))
    }

    /// Returns a uniform number from 0 to 1.
    fn uniform(&mut self) -> f64 {
        self.0.unit()
    }

    /// Returns a normal number with mean 0 and standard deviation 1 (Box and Muller).
    fn normal(&mut self) -> f64 {
        let (radius, angle) = ((-2.0 * self.uniform().max(1e-12).ln()).sqrt(), self.uniform());
        radius * (std::f64::consts::TAU * angle).cos()
    }

    /// Returns a latency around `mean`. `spread` is the standard deviation of its logarithm. A few latencies are much
    /// longer.
    fn latency(&mut self, mean: f64, spread: f64) -> f64 {
        let tail = if self.uniform() < 0.004 { mean * 8.0 * self.uniform() } else { 0.0 };
        mean * (spread * self.normal()).exp() + tail
    }
}

fn row(number: u64, at: f64, values: Vec<(Column, f64)>) -> Row {
    Row {
        iteration: number,
        at: 1.795e9 + at,
        episode: (number / 2000) as u32,
        step: (number % 2000) as u32,
        warm_up: number <= 5,
        outcome: Outcome::Ok,
        reason: None,
        values,
        upload: None,
        download: None,
    }
}

fn loaded(title: &str, rows: Rows) -> Loaded {
    let record = RunRecord { title: title.to_owned(), name: title.to_owned(), ..RunRecord::default() };
    Loaded { folder: title.replace([' ', ','], "-").into(), record, rows }
}

/// Returns the columns of a row with these stages, each with its time in seconds. 0.4 ms are unattributed.
fn values(stages: &[(&'static str, f64)]) -> Vec<(Column, f64)> {
    let sum: f64 = stages.iter().map(|(_, value)| value).sum();
    let mut columns: Vec<(Column, f64)> =
        stages.iter().map(|(name, value)| ((*name).into(), *value)).collect();
    columns.extend([
        ("total".into(), sum + 0.4e-3),
        ("stages-total".into(), sum),
        ("unattributed".into(), 0.4e-3),
    ]);
    columns
}

/// Returns a run with a model in the cloud.
pub(crate) fn remote(model: &str, network: &str, count: u64) -> Loaded {
    let mut rng = TestRng::new(7);
    let mut at = 0.0;
    let mut rows = Vec::new();
    for number in 1..=count {
        // In a twentieth of the run, the network is slow.
        let network_slowdown = if (count / 2..count * 11 / 20).contains(&number) { 1.8 } else { 1.0 };
        let cold_start_slowdown = if number <= 5 { 6.0 } else { 1.0 };
        let upload = rng.latency(17.5e-3 * network_slowdown, 0.12);
        let download = rng.latency(0.37e-3, 0.25);
        let typical_length = if rng.uniform() < 0.6 { 180.0 } else { 420.0 };
        let answer_bytes = (typical_length + 30.0 * rng.normal()).round().max(8.0);
        let inference = cold_start_slowdown * (3.7e-3 + answer_bytes * 20e-6 + 0.3e-3 * rng.normal().abs());
        let mut values = values(&[
            ("sensing", rng.latency(0.76e-3, 0.3)),
            ("encode", 0.05e-3),
            ("upload", upload),
            ("queue", 0.02e-3),
            ("preprocessing", rng.latency(1.4e-3, 0.1)),
            ("inference", inference),
            ("postprocessing", 0.08e-3),
            ("download", download),
        ]);
        values.extend([
            ("upload-bytes".into(), PICTURE_BYTES),
            ("download-bytes".into(), answer_bytes),
            ("upload-throughput".into(), (PICTURE_BYTES + METADATA_BYTES) * 8.0 / upload),
            ("download-throughput".into(), (answer_bytes + METADATA_BYTES) * 8.0 / download),
        ]);
        at += 0.032 * network_slowdown;
        let mut row = row(number, at, values);
        if number % 997 == 0 {
            (row.outcome, row.values) = (Outcome::Lost, Vec::new());
        }
        rows.push(row);
    }
    let mut run = loaded(&format!("{model} over {network}"), rows.into_iter().collect());
    set_placement(&mut run, model, "remote", "cuda:0", Some(network));
    run
}

/// Sets the model, the placement and the edge of a run.
fn set_placement(run: &mut Loaded, model: &str, kind: &str, device: &str, network: Option<&str>) {
    let model = ModelRecord { name: model.to_owned(), device: Some(device.to_owned()), sha256: None };
    run.record.model = Some(model);
    run.record.placement =
        Placement { kind: kind.to_owned(), network: network.map(str::to_owned), address: None };
    run.record.edge = HostRecord { name: "robot".to_owned(), ..HostRecord::default() };
}

/// Returns runs of three models on the robot and in the cloud: the paper's first experiment.
pub(crate) fn experiment() -> Vec<Loaded> {
    let mut rng = TestRng::new(3);
    let mut runs = Vec::new();
    for (model, local_inference) in
        [("efficientnet_v2_s", 62e-3), ("efficientnet_v2_m", 95e-3), ("efficientnet_v2_l", 151e-3)]
    {
        for kind in ["local", "remote"] {
            let rows = (1..=2000).map(|number| {
                let stages = if kind == "local" {
                    vec![
                        ("sensing", rng.latency(0.7e-3, 0.2)),
                        ("inference", local_inference * (1.0 + 0.01 * rng.normal())),
                    ]
                } else {
                    vec![
                        ("sensing", rng.latency(0.7e-3, 0.2)),
                        ("upload", rng.latency(17e-3, 0.2)),
                        ("inference", rng.latency(local_inference / 2.5, 0.2)),
                        ("download", rng.latency(0.5e-3, 0.2)),
                    ]
                };
                row(number, number as f64, values(&stages))
            });
            let mut run = loaded(&format!("{model} {kind}"), rows.collect());
            let device = if kind == "local" { "cuda:0" } else { "cuda:6" };
            set_placement(&mut run, model, kind, device, (kind == "remote").then_some("zmq-tcp"));
            let configuration =
                vec![("model".to_owned(), model.to_owned()), ("where".to_owned(), kind.to_owned())];
            let (name, id) = ("efficientnet".to_owned(), "1".to_owned());
            run.record.experiment = Some(ExperimentPosition {
                name,
                id,
                configuration,
                repeat: 0,
                ..ExperimentPosition::default()
            });
            runs.push(run);
        }
    }
    runs
}

/// Returns runs with the means and standard deviations of the table of the paper's third experiment.
pub(crate) fn teleoperation() -> Vec<Loaded> {
    // Resizing, GPU, network, and the means and the standard deviations of the four stages in ms.
    let lines = [
        ("no", "Jetson Orin", "none", [0.71, 0.0, 18.55, 0.0], [0.26, 0.0, 3.34, 0.0]),
        ("no", "RTX 3090", "LAN", [0.76, 17.53, 3.73, 0.37], [0.25, 1.72, 1.12, 0.12]),
        ("yes", "RTX 3090", "LAN", [4.71, 6.25, 3.48, 0.62], [1.08, 0.99, 1.11, 0.11]),
        ("no", "RTX 3090", "CAN", [0.81, 98.28, 3.73, 1.73], [0.28, 11.33, 1.53, 1.81]),
        ("yes", "RTX 3090", "CAN", [4.50, 14.53, 3.43, 2.24], [1.03, 10.13, 1.52, 6.05]),
        ("no", "A100", "CAN", [0.79, 102.48, 7.19, 3.16], [0.27, 26.40, 3.38, 8.95]),
        ("yes", "A100", "CAN", [4.83, 15.13, 6.71, 3.59], [1.08, 7.63, 3.05, 4.83]),
    ];
    let mut rng = TestRng::new(5);
    let run = |(resize, gpu, network, means, stds): (&str, &str, &str, [f64; 4], [f64; 4])| {
        let names = ["sensing", "upload", "inference", "download"];
        let rows = (1..=500).map(|number| {
            let stages: Vec<(&'static str, f64)> = (0..4)
                .filter(|index| means[*index] > 0.0)
                .map(|index| (names[index], (means[index] + stds[index] * rng.normal()).max(0.01) / 1e3))
                .collect();
            row(number, number as f64, values(&stages))
        });
        let mut run = loaded(&format!("{resize} {gpu} {network}"), rows.collect());
        let pair = |axis: &str, label: &str| (axis.to_owned(), label.to_owned());
        let configuration = vec![pair("resize", resize), pair("GPU", gpu), pair("network", network)];
        let (name, id) = ("teleoperation".to_owned(), "1".to_owned());
        run.record.experiment =
            Some(ExperimentPosition { name, id, configuration, repeat: 0, ..ExperimentPosition::default() });
        run
    };
    lines.into_iter().map(run).collect()
}

/// Returns a run with payloads of seven sizes.
pub(crate) fn payload() -> Loaded {
    let mut rng = TestRng::new(9);
    let sizes = [1e3, 3e3, 1e4, 3e4, 1e5, 3e5, 1e6];
    let rows = (1..=1400).map(|number| {
        let size = sizes[number as usize % sizes.len()];
        let delay = |rng: &mut TestRng, bytes: f64| rng.latency(0.21e-3 + bytes / 110e6, 0.06);
        let (up, down) = (delay(&mut rng, size + 300.0), delay(&mut rng, size + 400.0));
        let mut values = values(&[("sensing", 1e-4), ("upload", up), ("download", down)]);
        values.extend([
            ("upload-bytes".into(), size),
            ("upload-logger-bytes".into(), 300.0),
            ("download-bytes".into(), size),
            ("download-logger-bytes".into(), 400.0),
        ]);
        row(number, number as f64, values)
    });
    let mut run = loaded("payload study", rows.collect());
    set_placement(&mut run, "echo", "remote", "cpu", Some("zmq-tcp"));
    run
}

/// Returns runs of a model that takes 12 ms and a model that takes 40 ms. Each model has one worker, which up to
/// sixteen edges use at the same time.
pub(crate) fn users() -> Vec<Loaded> {
    let mut rng = TestRng::new(11);
    let mut runs = Vec::new();
    for (model, service) in [("efficientnet_v2_s", 12e-3), ("efficientnet_v2_l", 40e-3)] {
        for edges in [1_u32, 2, 4, 8, 16] {
            for edge in 0..edges {
                // Edges with a lower index wait a little less, so that the fairness is below 1.
                let advantage = 1.0 - 0.2 * f64::from(edges - 1 - edge) / f64::from(edges);
                let mean_wait = 4e-3 + service * f64::from(edges) * advantage;
                let mut at = 0.0;
                let rows = (1..=200).map(|number| {
                    let stages =
                        [("sensing", 1e-3), ("upload", 2e-3), ("queue", rng.latency(mean_wait, 0.12))];
                    let stages = [&stages[..], &[("inference", service), ("download", 4e-4)]].concat();
                    let values = values(&stages);
                    at += stages.iter().map(|(_, value)| value).sum::<f64>();
                    row(number, at, values)
                });
                let mut run = loaded(&format!("{model} {edges} {edge}"), rows.collect());
                set_placement(&mut run, model, "remote", "cuda:6", Some("zmq-tcp"));
                run.record.edge.name = format!("robot-{edge}");
                let pair = |axis: &str, label: String| (axis.to_owned(), label);
                let configuration = vec![pair("model", model.to_owned()), pair("edges", edges.to_string())];
                let (name, id) = ("users".to_owned(), "1".to_owned());
                run.record.experiment = Some(ExperimentPosition {
                    name,
                    id,
                    configuration,
                    repeat: 0,
                    ..ExperimentPosition::default()
                });
                runs.push(run);
            }
        }
    }
    runs
}
