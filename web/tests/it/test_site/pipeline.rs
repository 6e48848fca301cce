//! One pipeline, with the durations of its stages.

use peernet_clock::WallTime;
use peernet_logger::{Name, RunId, stage};
use peernet_statistics::{SplitMix64, Summary};
use peernet_stream::{OutcomeCounts, Placement, PlacementKind, Second, bound_names};

/// Length of an answer in bytes. Only the stored iterations of a pipeline with varying answers have other lengths.
pub(super) const ANSWER_BYTES: f64 = 412.0;

/// Relation of the clocks of a pipeline's two hosts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Clocks {
    /// Both hosts read one clock.
    Shared,
    /// The offset is known within ± this number of seconds.
    Within(f64),
    /// The clocks were never related.
    Unrelated,
}

/// A pipeline on a camera.
#[derive(Clone, Debug)]
pub(crate) struct TestPipeline {
    /// Name of the pipeline.
    pub(crate) name: &'static str,
    /// Name of the camera.
    pub(crate) host: &'static str,
    /// `true` if the rack computes for the pipeline.
    pub(crate) is_remote: bool,
    /// Iterations per second.
    pub(crate) hz: f64,
    /// Relation of the clocks of the camera and the rack.
    pub(crate) clocks: Clocks,
    /// Bytes of a sample.
    pub(crate) bytes: f64,
    /// Bytes of the shortest and the longest answer.
    pub(crate) answer_bytes: (f64, f64),
    /// Stages with mean and deviation in ms.
    pub(crate) stages: Vec<(Name, f64, f64)>,
    /// Current run.
    pub(crate) run: Option<RunId>,
    /// `true` if a fault is injected into the camera's clock.
    pub(crate) has_clock_fault: bool,
}

impl TestPipeline {
    /// Returns a pipeline that computes on board.
    pub(crate) fn local() -> Self {
        Self::new(
            "local",
            "cam-1",
            false,
            Clocks::Shared,
            0.0,
            &[2.05, 0.0, 0.0, 0.02, 2.62, 13.1, 0.72, 0.0, 0.31],
        )
    }

    /// Returns a pipeline that sends the whole picture to the rack.
    pub(crate) fn full() -> Self {
        Self::new(
            "offload-full",
            "cam-2",
            true,
            Clocks::Within(0.000_09),
            1_228_800.0,
            &[1.99, 0.34, 11.6, 0.06, 3.08, 3.5, 0.21, 0.61, 0.21],
        )
    }

    /// Returns a pipeline that reduces the picture before it sends it.
    pub(crate) fn resized() -> Self {
        Self::new(
            "offload-resized",
            "cam-3",
            true,
            Clocks::Within(0.000_65),
            150_500.0,
            &[4.7, 0.1, 6.3, 0.04, 0.31, 3.5, 0.21, 0.62, 0.21],
        )
    }

    /// Returns `resized` over clocks that were never related.
    pub(crate) fn unrelated() -> Self {
        Self { name: "offload-unrelated", clocks: Clocks::Unrelated, ..Self::resized() }
    }

    /// Returns `resized` on a camera with an injected clock fault.
    pub(crate) fn with_clock_fault() -> Self {
        Self { has_clock_fault: true, ..Self::resized() }
    }

    /// Returns `resized` with both agents on one machine.
    pub(crate) fn one_clock() -> Self {
        Self { name: "offload-here", clocks: Clocks::Shared, ..Self::resized() }
    }

    /// Returns `resized` with answers of different lengths.
    pub(crate) fn varying_answers() -> Self {
        Self { name: "offload-answers", answer_bytes: (100.0, 900.0), ..Self::resized() }
    }

    /// Returns a pipeline. `means` are the means of the stages in ms, in the order of `names` below. A stage with the
    /// mean 0 is left out.
    fn new(
        name: &'static str,
        host: &'static str,
        is_remote: bool,
        clocks: Clocks,
        bytes: f64,
        means: &[f64; 9],
    ) -> Self {
        let names = [
            stage::SENSING,
            stage::ENCODE,
            stage::UPLOAD,
            stage::QUEUE,
            stage::PREPROCESSING,
            stage::INFERENCE,
            stage::POSTPROCESSING,
            stage::DOWNLOAD,
            stage::ACTUATION,
        ];
        let spread = |name: &Name, mean: f64| if *name == stage::UPLOAD { mean * 0.1 } else { mean * 0.04 };
        let stages = names.into_iter().zip(means).filter(|(_, mean)| **mean > 0.0);
        let stages = stages.map(|(name, mean)| (name.clone(), *mean, spread(&name, *mean)));
        Self {
            name,
            host,
            is_remote,
            hz: 30.0,
            clocks,
            bytes,
            answer_bytes: (ANSWER_BYTES, ANSWER_BYTES),
            stages: stages.collect(),
            run: None,
            has_clock_fault: false,
        }
    }

    /// Draws the stage durations of one iteration, seconds. `when` is its position in the run, 0 to 1. The network is
    /// slow for a part of the run, and a few iterations take much longer.
    pub(crate) fn draw(&self, random: &mut SplitMix64, when: f64) -> Vec<(Name, f64)> {
        let slow = if (0.42..0.45).contains(&when) { 1.9 } else { 1.0 };
        let is_outlier = random.unit() < 0.001;
        let stages = self.stages.iter().map(|(name, mean, spread)| {
            let mut value = mean + spread * random.normal();
            if *name == stage::UPLOAD {
                value *= slow * if is_outlier { 3.0 + 2.0 * random.unit() } else { 1.0 };
            } else if *name == stage::INFERENCE && is_outlier && !self.is_remote {
                value *= 2.0;
            }
            (name.clone(), value.max(mean * 0.2) / 1e3)
        });
        stages.collect()
    }

    /// Returns whether the camera was silent `ago` seconds ago. The camera of `offload-full` was silent for 35 seconds,
    /// until 200 seconds ago.
    pub(crate) fn is_silent(&self, ago: i64) -> bool {
        self.name == "offload-full" && (200..235).contains(&ago)
    }

    /// Returns the placement of the pipeline.
    pub(crate) fn placement(&self) -> Placement {
        let name = |text: &str| text.parse().expect("a name");
        Placement {
            kind: if self.is_remote { PlacementKind::Remote } else { PlacementKind::Local },
            peer: self.is_remote.then(|| name("rack-a")),
            network: self.is_remote.then(|| "zmq-tcp".into()),
            address: self.is_remote.then(|| "tcp://192.0.2.5:5551".into()),
            model: name("quality-control"),
            device: Some("cpu".into()),
        }
    }

    /// Returns the facts of the configuration, for people.
    pub(crate) fn facts(&self) -> Vec<(String, String)> {
        let pairs =
            [("Sensor", "images, 1280 × 960"), ("Transforms", "resize to 320 × 240"), ("Load", "30 Hz")];
        let faults = self.has_clock_fault.then_some(("Clock fault", "+1,000 ms, +50 ppm"));
        pairs.into_iter().chain(faults).map(|(name, value)| (name.to_owned(), value.to_owned())).collect()
    }

    /// Returns the configuration as in the configuration file.
    pub(crate) fn configuration(&self) -> String {
        format!(
            "name = \"{}\"\nload = {{ kind = \"rate\", hz = {} }}\nmodel = \"quality-control\"\n",
            self.name, self.hz
        )
    }

    /// Returns the data of the second that begins at the Unix time `at`; of the current second only the part before
    /// `now`.
    pub(crate) fn second(&self, at: i64, now: WallTime, random: &mut SplitMix64) -> Second {
        let elapsed = (now - WallTime::from_unix_nanos(at * 1_000_000_000)).seconds().clamp(0.0, 1.0);
        let ok = (self.hz * elapsed).round() as u64;
        let mut values: Vec<(Name, Summary)> = Vec::new();
        let mut record = |name: Name, value: f64| {
            let at = values.iter().position(|(known, _)| *known == name).unwrap_or_else(|| {
                values.push((name.clone(), Summary::default()));
                values.len() - 1
            });
            values[at].1.record(value);
        };
        let half_width = match self.clocks {
            Clocks::Within(bound) => bound,
            Clocks::Shared | Clocks::Unrelated => 0.0,
        };
        let mut half_widths = Summary::default();
        let mut ends: Vec<(Name, Summary)> = Vec::new();
        // `draw` treats each ten minutes as one run, so that each ten minutes contain a slow part.
        let when = (at % 600) as f64 / 600.0;
        for _ in 0..ok {
            let stages = self.draw(random, when);
            let sum: f64 = stages.iter().map(|(_, value)| value).sum();
            let unattributed = 0.000_11;
            for (name, value) in stages {
                let is_transit = name == stage::UPLOAD || name == stage::DOWNLOAD;
                if is_transit && self.clocks == Clocks::Unrelated {
                    continue;
                }
                if name == stage::UPLOAD {
                    record(stage::UPLOAD_THROUGHPUT, self.bytes * 8.0 / value);
                } else if name == stage::DOWNLOAD && self.name == "offload-full" {
                    // The other pipelines lack this quantity, so that pages are tested with it and without it.
                    record(stage::DOWNLOAD_THROUGHPUT, ANSWER_BYTES * 8.0 / value);
                }
                if let Some(names) = bound_names(&name) {
                    for (name, end) in names.into_iter().zip([value - half_width, value + half_width]) {
                        let at = ends.iter().position(|(known, _)| *known == name).unwrap_or_else(|| {
                            ends.push((name, Summary::default()));
                            ends.len() - 1
                        });
                        ends[at].1.record(end.max(0.0));
                    }
                }
                record(name, value);
            }
            record(stage::TOTAL, sum + unattributed);
            record(stage::STAGES_TOTAL, sum);
            record(stage::UNATTRIBUTED, unattributed);
            if self.is_remote {
                record(stage::UPLOAD_BYTES, self.bytes);
                record(stage::DOWNLOAD_BYTES, ANSWER_BYTES);
                half_widths.record(half_width);
            }
        }
        let directions = if self.is_remote { vec![stage::UPLOAD, stage::DOWNLOAD] } else { Vec::new() };
        let is_known = self.clocks != Clocks::Unrelated;
        let bounds = directions.iter().filter(|_| is_known).map(|name| (name.clone(), half_widths.clone()));
        let verdicts =
            directions.iter().map(|name| (name.clone(), Name::from_static(self.verdict(name)), ok));
        Second {
            at,
            counts: OutcomeCounts { ok, failed: 0, lost: u64::from(ok > 0 && at % 97 == 0), timeout: 0 },
            bounds: bounds.chain(ends).collect(),
            verdicts: verdicts.collect(),
            values,
        }
    }

    /// Returns the verdict on the delays of a direction.
    pub(crate) fn verdict(&self, name: &Name) -> &'static str {
        let mean =
            self.stages.iter().find(|(known, ..)| known == name).map_or(0.0, |(_, mean, _)| mean / 1e3);
        match self.clocks {
            // As in the clock estimator: the interval of the delay is wider than half the delay.
            Clocks::Within(bound) if 2.0 * bound > mean / 2.0 => "limited",
            Clocks::Unrelated => "unsynchronised",
            Clocks::Within(_) | Clocks::Shared => "ok",
        }
    }
}
