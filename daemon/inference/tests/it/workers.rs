use std::sync::Arc;
use std::sync::mpsc::sync_channel;

use peernet_inference::{FinishedJob, Job};
use peernet_logger::{HostId, Recorder};

use super::{Answer, answer, bank, clock, jpeg, loaded, pictures, quality_control_with, run};

/// Returns the answers of the demo model to all 30 pictures of the demo. All pictures are submitted before the first
/// answer is received. `lines` are further lines of the model's table and must set a queue that holds all pictures.
fn answers(lines: &str) -> Vec<Answer> {
    let bank = bank(&[&quality_control_with(lines)]);
    let pool = loaded(&bank, "qc");
    let clock = clock();
    let (sender, receiver) = sync_channel(30);
    for (index, (file, _)) in pictures("pictures").into_iter().enumerate() {
        let sender = sender.clone();
        let reply = Box::new(move |done: FinishedJob| {
            sender.send((index, done.result)).expect("the test waits for the result");
        });
        let recorder = Recorder::new(Arc::clone(&clock), HostId::random());
        let job = Job::for_whole_answer(jpeg(file), recorder, clock.mono(), reply);
        pool.submit(job).expect("the queue has room");
    }
    drop(sender);
    let mut results: Vec<_> = receiver.iter().collect();
    results.sort_by_key(|(index, _)| *index);
    results.into_iter().map(|(_, result)| answer(result)).collect()
}

/// Checks that answers are equal up to rounding: another number of threads may change the order of additions.
fn assert_equal(a: &[Answer], b: &[Answer]) {
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(b) {
        assert_eq!(a.label, b.label);
        assert!((a.score - b.score).abs() < 1e-4, "{a:?} {b:?}");
    }
}

#[test]
fn answers_are_independent_of_workers_and_threads() {
    let one_worker = answers("queue = 30");
    assert_equal(&one_worker, &answers("queue = 30\nworkers = 3"));
    assert_equal(&one_worker, &answers("queue = 30\nworkers = 2\nintra_threads = 2\ninter_threads = 2"));
}

#[test]
fn pool_serves_until_it_is_shut_down() {
    let bank = bank(&[&quality_control_with("workers = 2")]);
    let pool = loaded(&bank, "qc");
    assert_eq!((pool.workers(), pool.waiting_samples()), (2, 0));
    let (file, _) = pictures("pictures").swap_remove(0);
    assert!(run(&pool, jpeg(file.clone())).result.is_ok());
    bank.shutdown();
    let clock = clock();
    let recorder = Recorder::new(Arc::clone(&clock), HostId::random());
    let job = Job::for_whole_answer(jpeg(file), recorder, clock.mono(), Box::new(|_| {}));
    let refused = pool.submit(job).expect_err("is shut down");
    assert_eq!(refused.reason.to_string(), "model qc is shutting down");
}
