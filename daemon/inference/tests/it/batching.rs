//! Tests of batches: several requests in one run of an ONNX model.

use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

use peernet_inference::{
    Bank, Cancelled, FinishedJob, InferenceError, Job, LoadError, PartialAnswerError, Requester,
    UncancelledRequester,
};
use peernet_logger::{HostId, Recorder, Tree};
use peernet_sample::{ElementType, Part, Sample};
use tokio_util::sync::CancellationToken;

use super::graphs::{array, bytes, floats, model_table, models, pixels};
use super::termination::CancellableRequester;
use super::{bank, clock, loaded, slug};

/// Requester whose request was cancelled before it was submitted.
struct CancelledRequester;

impl Requester for CancelledRequester {
    fn send_partial_answer(&self, _partial_answer: Sample) -> Result<(), PartialAnswerError> {
        Err(Cancelled.into())
    }

    fn cancellation(&self) -> CancellationToken {
        let token = CancellationToken::new();
        token.cancel();
        token
    }

    fn wait(&self, _duration: Duration) -> Result<(), Cancelled> {
        Err(Cancelled)
    }
}

/// Returns a bank with a generated model that has the key `batch`. A model whose name begins with `open-` has an open
/// batch dimension.
fn batching_bank(name: &str, batch: &str) -> Bank {
    bank(&[&format!("{}\nbatch = {batch}", model_table(name, &models().join(name)))])
}

/// Submits requests. Returns their results in the order of the requests.
fn run_all(bank: &Bank, name: &str, requests: Vec<(Vec<Part>, Arc<dyn Requester>)>) -> Vec<FinishedJob> {
    let pool = loaded(bank, name);
    let clock = clock();
    let (sender, receiver) = sync_channel(requests.len());
    for (index, (parts, requester)) in requests.into_iter().enumerate() {
        let sender = sender.clone();
        let job = Job {
            sample: Sample { parts, source: String::new(), label: None },
            recorder: Recorder::new(Arc::clone(&clock), HostId::random()),
            received_at: clock.mono(),
            requester,
            reply: Box::new(move |done| sender.send((index, done)).expect("the test waits for the result")),
        };
        pool.submit(job).expect("the queue has room");
    }
    drop(sender);
    let mut finished: Vec<_> = receiver.iter().collect();
    finished.sort_by_key(|(index, _)| *index);
    finished.into_iter().map(|(_, done)| done).collect()
}

fn uncancelled_request(parts: Vec<Part>) -> (Vec<Part>, Arc<dyn Requester>) {
    (parts, Arc::new(UncancelledRequester))
}

fn row(numbers: &[f32]) -> Vec<Part> {
    vec![array(ElementType::F32, &[1, numbers.len() as u32], bytes(numbers))]
}

/// Returns the numbers in the first part of an answer.
fn numbers(done: &FinishedJob) -> Vec<f32> {
    let answer = done.result.as_ref().unwrap_or_else(|error| panic!("{error}"));
    floats(&answer.parts[0].bytes)
}

/// Returns the value of a node of a finished job.
fn value(done: FinishedJob, path: &[&str]) -> Option<f64> {
    done.recorder.finish().find(path)?.1.measure.value()
}

#[test]
fn batch_answers_each_of_its_samples() {
    let bank = batching_bank("open-policy", "{ max_size = 4, max_wait_ms = 60000 }");
    let sample = |index: u8| {
        let front = pixels((2, 2), vec![10 * index; 12]);
        let mut parts = vec![front];
        parts.extend(row(&[f32::from(index), 600.0]));
        uncancelled_request(parts)
    };
    let finished = run_all(&bank, "open-policy", (0..4).map(sample).collect());
    for (index, done) in finished.into_iter().enumerate() {
        // 2 × state + mean of the bytes + constant.
        let (state, mean) = (index as f32, 10.0 * index as f32);
        assert_eq!(numbers(&done), [2.0 * state + mean + 10.0, 1200.0 + mean - 1000.0]);
        let answer = done.result.as_ref().expect("is checked");
        assert_eq!(answer.parts[1], array(ElementType::Bool, &[1, 2], vec![1, 1]));
        let tree = done.recorder.finish();
        for stage in ["queue", "batch-wait", "preprocessing", "inference", "postprocessing"] {
            assert!(tree.find(&[stage]).is_some(), "{stage} in {tree:?}");
        }
        let size = tree.find(&["inference", "batch-size"]).expect("is recorded").1.measure.value();
        assert_eq!(size, Some(4.0));
    }
}

#[test]
fn batch_starts_after_max_wait_of_first_request() {
    let bank = batching_bank("open-root", "{ max_size = 4, max_wait_ms = 20 }");
    let mut finished = run_all(&bank, "open-root", vec![uncancelled_request(row(&[4.0, 9.0, 16.0]))]);
    let done = finished.remove(0);
    assert_eq!(numbers(&done), [2.0, 3.0, 4.0]);
    let tree = done.recorder.finish();
    let node_value =
        |path: &[&str]| tree.find(path).and_then(|(_, node)| node.measure.value()).expect("is recorded");
    assert_eq!(node_value(&["inference", "batch-size"]), 1.0);
    assert!(node_value(&["batch-wait"]) >= 0.02, "{tree:?}");
}

#[test]
fn single_requester_waits_only_once_for_others() {
    let bank = batching_bank("open-root", "{ max_size = 4, max_wait_ms = 1000 }");
    let wait_s = || {
        let done = run_all(&bank, "open-root", vec![uncancelled_request(row(&[4.0, 9.0, 16.0]))]).remove(0);
        value(done, &["batch-wait"]).expect("is recorded")
    };
    assert!(wait_s() >= 1.0, "the first batch waits for other requests");
    for _ in 0..20 {
        let seconds = wait_s();
        assert!(seconds < 1.0, "no other requests are expected: waited {seconds} s");
    }
}

#[test]
fn failure_of_one_sample_does_not_affect_others() {
    let bank = batching_bank("open-root", "{ max_size = 4, max_wait_ms = 60000 }");
    let requests = vec![
        uncancelled_request(row(&[4.0, 9.0, 16.0])),
        uncancelled_request(row(&[1.0, 2.0])),
        (row(&[1.0, 1.0, 1.0]), Arc::new(CancelledRequester) as Arc<dyn Requester>),
        uncancelled_request(row(&[1.0, -1.0, 1.0])),
    ];
    let mut finished = run_all(&bank, "open-root", requests);
    assert_eq!(numbers(&finished[0]), [2.0, 3.0, 4.0]);
    let errors: Vec<_> = finished[1..].iter().map(|done| done.result.clone().expect_err("fails")).collect();
    assert!(
        errors[0].to_string().contains("its array is float32 [1, 2], the model requires float32 [1, 3]"),
        "{}",
        errors[0]
    );
    assert_eq!(errors[1], InferenceError::Cancelled { model: "open-root".to_owned() });
    assert!(errors[2].to_string().contains("contains NaN"), "{}", errors[2]);
    assert_eq!(
        value(finished.remove(0), &["inference", "batch-size"]),
        Some(2.0),
        "two samples of the batch were computed"
    );
    assert_eq!(value(finished.remove(0), &["inference"]), None, "the second sample was not computed");
}

fn indices(numbers: [i64; 3]) -> Vec<Part> {
    let bytes = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
    vec![array(ElementType::I64, &[1, 3], bytes)]
}

#[test]
fn run_that_library_refuses_is_repeated_for_each_sample() {
    let bank = batching_bank("table", "{ max_size = 3, max_wait_ms = 60000 }");
    // ONNX Runtime refuses the index 5000, and with it the run of the whole batch.
    let requests = [[1, 2, 3], [4, 5_000, 6], [7, 8, 9]].map(|numbers| uncancelled_request(indices(numbers)));
    let finished = run_all(&bank, "table", requests.into());
    assert_eq!(numbers(&finished[0]), [1.0, 4.0, 9.0]);
    assert_eq!(numbers(&finished[2]), [49.0, 64.0, 81.0]);
    let error = finished[1].result.clone().expect_err("has no such index").to_string();
    assert!(error.contains("5000"), "{error}");
    let trees: Vec<Tree> = finished.into_iter().map(|done| done.recorder.finish()).collect();
    for tree in &trees {
        // The refused run also took time of this iteration, but only the run with an answer has the node `batch-size`.
        assert_eq!(values(tree, "inference").len(), 2, "{tree:?}");
        assert_eq!(values(tree, "batch-size"), [1.0], "{tree:?}");
        // A request waits for its batch to be collected, before its own run, and after its own run.
        assert_eq!(values(tree, "batch-wait").len(), 3, "{tree:?}");
    }
    // The first sample waits for the others after its own run, and the last sample waits before its own run.
    let (first, last) = (values(&trees[0], "batch-wait"), values(&trees[2], "batch-wait"));
    assert!(first[2] >= values(&trees[2], "inference")[1], "{trees:?}");
    assert!(last[1] >= values(&trees[0], "inference")[1], "{trees:?}");
}

/// Returns the values of all nodes with a name, in their order.
fn values(tree: &Tree, name: &str) -> Vec<f64> {
    tree.nodes().iter().filter(|node| node.name == name).filter_map(|node| node.measure.value()).collect()
}

/// The batch has a sample whose computation never ends, two samples whose computations end, and seven further samples.
/// The requests of the first and the further samples are cancelled one after the other.
#[test]
fn cancelled_request_does_not_hold_up_its_batch() {
    const ENDLESS: i64 = 1 << 60;
    // Input of the model: the number of runs of its loop.
    let loop_runs = |runs: i64| vec![array(ElementType::I64, &[1, 1], runs.to_le_bytes().to_vec())];
    let mut tokens: Vec<CancellationToken> = (0..8).map(|_| CancellationToken::new()).collect();
    let requester =
        |token: &CancellationToken| Arc::new(CancellableRequester(token.clone())) as Arc<dyn Requester>;
    let mut requests = vec![(loop_runs(ENDLESS), requester(&tokens[0]))];
    requests.extend([uncancelled_request(loop_runs(5)), uncancelled_request(loop_runs(7))]);
    requests.extend(tokens[1..].iter().map(|token| (loop_runs(1), requester(token))));
    let batch = format!("{{ max_size = {}, max_wait_ms = 60000 }}", requests.len());
    let bank = batching_bank("open-counter", &batch);
    let (end_sender, end_receiver) = sync_channel::<()>(0);
    let canceller = std::thread::spawn(move || {
        // A cancellation ends the run only if the run has taken twice as long as the longest run before. The first
        // cancellation may come too early. A later cancellation then ends the run.
        while end_receiver.recv_timeout(Duration::from_millis(500)) == Err(RecvTimeoutError::Timeout) {
            if !tokens.is_empty() {
                tokens.remove(0).cancel();
            }
        }
    });
    let finished = run_all(&bank, "open-counter", requests);
    drop(end_sender);
    canceller.join().expect("does not panic");
    assert_eq!(finished[0].result, Err(InferenceError::Cancelled { model: "open-counter".to_owned() }));
    for (done, expected) in finished[1..3].iter().zip([5_i64, 7]) {
        let answer = done.result.as_ref().unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(answer.parts[0].bytes[..], expected.to_le_bytes());
    }
    let last = finished.last().expect("the batch has requests");
    assert!(last.result.is_ok(), "the run ended only after all requests were cancelled: {:?}", last.result);
}

#[test]
fn model_that_cannot_compute_batches_is_refused() {
    let refusal = |name: &str, batch: &str| -> LoadError {
        batching_bank(name, batch).load(&slug(name), None).map(drop).expect_err("is refused")
    };
    let error = refusal("root", "{ max_size = 2 }").to_string();
    assert!(error.contains("its input \"x\" takes one sample at a time; remove `batch`"), "{error}");
    let error = refusal("mean-of-rows", "{ max_size = 2 }").to_string();
    assert!(error.contains("a row for each sample of the batch"), "{error}");
    let error = refusal("open-root", "{ max_size = 2, max_wait_ms = -1.0 }").to_string();
    assert!(error.contains("batch.max_wait_ms of model open-root: -1 is not a time"), "{error}");
    let error = refusal("open-root", "{ max_size = 100000 }").to_string();
    assert!(error.contains("100000 is too large; at most 1024"), "{error}");
}
