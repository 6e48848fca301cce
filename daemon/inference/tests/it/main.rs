//! Tests of models through the bank and the pool, as an agent uses them. Many tests use the committed demo model and
//! its pictures, and ONNX Runtime, which `make setup` fetches.

mod accuracy;
mod bank;
mod batching;
mod detection;
mod distribution;
mod exec;
mod folders;
mod graphs;
mod invalid_outputs;
mod openai;
mod process;
mod python;
mod recording_requester;
mod refusals;
mod samples;
mod termination;
mod workers;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::sync_channel;

use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
use peernet_inference::{Bank, FinishedJob, InferenceError, Job, ModelConfig, OnnxRuntimeConfig, Pool};
use peernet_logger::{HostId, Recorder, Slug};
use peernet_sample::{Description, MediaType, Sample};
use serde::Deserialize;

/// Returns the demo model's folder.
fn demo() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../models/quality-control")
        .canonicalize()
        .expect("is committed")
}

fn clock() -> SharedClock {
    Arc::new(SystemClock::new(ClockIdentity::new("test", ClockIdentity::SYSTEM)))
}

/// Returns a bank of `[[model]]` tables; each table is given as TOML text.
fn bank(models: &[&str]) -> Bank {
    let models = models.iter().map(|model| toml::from_str::<ModelConfig>(model).expect(model));
    Bank::new(models.collect(), OnnxRuntimeConfig::default(), clock())
}

/// Returns the `[[model]]` table of the demo model.
fn quality_control() -> String {
    quality_control_with("")
}

/// Returns the `[[model]]` table of the demo model, with additional lines.
fn quality_control_with(lines: &str) -> String {
    format!("name = \"qc\"\nkind = \"onnx\"\npath = {:?}\n{lines}", demo())
}

fn slug(name: &str) -> Slug {
    name.parse().expect("is a name")
}

fn loaded(bank: &Bank, name: &str) -> Arc<Pool> {
    bank.load(&slug(name), None).unwrap_or_else(|error| panic!("{error}"))
}

fn jpeg(bytes: Vec<u8>) -> Sample {
    Sample::from_part(Description::unshaped(MediaType::Jpeg), bytes.into())
}

/// Submits a sample and waits for its answer.
fn run(pool: &Pool, sample: Sample) -> FinishedJob {
    let (sender, receiver) = sync_channel(1);
    let clock = clock();
    let reply = Box::new(move |done| sender.send(done).expect("the test waits for the result"));
    let recorder = Recorder::new(Arc::clone(&clock), HostId::random());
    pool.submit(Job::for_whole_answer(sample, recorder, clock.mono(), reply)).expect("the queue has room");
    receiver.recv().expect("is answered")
}

/// Answer of a classifier.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Answer {
    label: String,
    score: f64,
    top: Vec<RankedLabel>,
}

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct RankedLabel {
    label: String,
    score: f64,
}

fn answer(result: Result<Sample, InferenceError>) -> Answer {
    let sample = result.unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(sample.parts[0].description.media, MediaType::Json);
    serde_json::from_slice(&sample.parts[0].bytes).expect("has the documented keys")
}

/// Line of a `labels.csv`: a picture of the demo with its label.
#[derive(Deserialize)]
struct LabelledPicture {
    file: String,
    label: String,
}

/// Returns the pictures in a folder of the demo model, each as the contents of its file and its label.
fn pictures(folder: &str) -> Vec<(Vec<u8>, String)> {
    let folder = demo().join(folder);
    let mut labels = csv::Reader::from_path(folder.join("labels.csv")).expect("is committed");
    labels
        .deserialize()
        .map(|row| row.expect("has file and label"))
        .map(|LabelledPicture { file, label }| {
            (std::fs::read(folder.join(file)).expect("is committed"), label)
        })
        .collect()
}
