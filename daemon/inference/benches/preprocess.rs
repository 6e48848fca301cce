//! Benchmark of the stages of a model for one picture. The model runs in a pool, as in an agent.
//!
//!     cargo bench -p peernet-inference --bench preprocess -- MODEL_FOLDER PICTURE [ROUNDS]
//!
//! `preprocess.py` in this folder does the same work with Pillow, numpy and Python's onnxruntime.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::sync_channel;

use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
use peernet_inference::{Bank, BankConfig, FinishedJob, Job, OnnxRuntimeConfig};
use peernet_logger::{HostId, Recorder, Slug};
use peernet_sample::{Description, MediaType, Sample};

const STAGES: [&str; 3] = ["preprocessing", "inference", "postprocessing"];

#[expect(clippy::print_stdout, reason = "a benchmark prints its table")]
fn main() {
    let arguments: Vec<_> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let demo = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../models/quality-control"));
    let folder = arguments.first().map_or(demo.clone(), PathBuf::from);
    let picture = arguments.get(1).map_or(demo.join("pictures/part-0001.jpg"), PathBuf::from);
    let rounds = arguments.get(2).map_or(200, |rounds| rounds.parse().expect("ROUNDS is a number"));

    let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("bench", ClockIdentity::SYSTEM)));
    let name: Slug = "bench".parse().expect("is a name");
    let config = BankConfig::default().model(&name, &folder, "cpu");
    let bank = Bank::new(vec![config], OnnxRuntimeConfig::default(), Arc::clone(&clock));
    let pool = bank.load(&name, None).expect("the model loads");
    let bytes = std::fs::read(&picture).expect("the picture is readable").into();
    let sample = Sample::from_part(Description::unshaped(MediaType::Jpeg), bytes);

    let mut durations = STAGES.map(|_| Vec::with_capacity(rounds));
    for _ in 0..rounds {
        let (sender, receiver) = sync_channel(1);
        let reply = Box::new(move |finished: FinishedJob| {
            sender.send(finished).expect("the benchmark waits for the result");
        });
        let recorder = Recorder::new(Arc::clone(&clock), HostId::random());
        let job = Job::for_whole_answer(sample.clone(), recorder, clock.mono(), reply);
        pool.submit(job).expect("the queue is empty");
        let FinishedJob { recorder, result } = receiver.recv().expect("the job is answered");
        result.expect("the picture is answered");
        let tree = recorder.finish();
        for (stage, times) in STAGES.iter().zip(&mut durations) {
            times.extend(tree.find(&[stage]).and_then(|(_, node)| node.measure.value()));
        }
    }
    println!("{:<16}{:>10}{:>10}   ms, {rounds} rounds", "", "min", "median");
    for (stage, times) in STAGES.iter().zip(&mut durations) {
        times.sort_by(f64::total_cmp);
        println!("{stage:<16}{:>10.3}{:>10.3}", times[0] * 1e3, times[times.len() / 2] * 1e3);
    }
}
