use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use peernet_clock::Span;
use peernet_inference::Job;
use peernet_logger::{HostId, Recorder};
use peernet_sample::{Description, Sample};

use super::{bank, clock, loaded, quality_control, run, slug};

const ECHO: &str = "name = \"echo\"\nkind = \"echo\"";
/// A model of kind `sleep` with the name `nap`.
const SLEEP: &str =
    "name = \"nap\"\nkind = \"sleep\"\npreprocessing_ms = 1\ninference_ms = 2\npostprocessing_ms = 1";

fn bytes(count: usize) -> Sample {
    Sample::from_part(Description::bytes(), vec![7; count].into())
}

#[test]
fn models_are_listed_in_configured_order() {
    let bank = bank(&[&quality_control(), ECHO, SLEEP]);
    assert_eq!(bank.names(), [slug("qc"), slug("echo"), slug("nap")]);
    assert!(bank.check().is_empty(), "{:?}", bank.check());
}

#[test]
fn model_is_loaded_once_and_shared() {
    let loads = Arc::new(AtomicUsize::new(0));
    let load_counter = Arc::clone(&loads);
    let bank = bank(&[&quality_control()]).on_load(move |pool| {
        assert_eq!((pool.name().as_str(), pool.device().as_str()), ("qc", "cpu"));
        load_counter.fetch_add(1, Ordering::SeqCst);
    });
    let pools = std::thread::scope(|scope| {
        let loaders = [(); 4].map(|()| scope.spawn(|| loaded(&bank, "qc")));
        loaders.map(|loader| loader.join().expect("does not panic"))
    });
    assert!(pools.iter().all(|pool| Arc::ptr_eq(pool, &pools[0])));
    assert_eq!(loads.load(Ordering::SeqCst), 1);
    assert!(pools[0].load_duration() > Span::ZERO);
    assert!(bank.load(&slug("qc"), Some("cpu")).is_ok());
}

#[test]
fn echo_answers_with_payload_or_configured_size() {
    let bank = bank(&[ECHO, "name = \"short\"\nkind = \"echo\"\nanswer_bytes = 3"]);
    let echo = loaded(&bank, "echo");
    assert!(!echo.runs_on_threads());
    assert_eq!(run(&echo, bytes(1000)).result, Ok(bytes(1000)));
    let short = run(&loaded(&bank, "short"), bytes(1000)).result.expect("echoes");
    assert_eq!(short.payload_bytes(), 3);
}

#[test]
fn sleep_model_takes_at_least_its_stage_times() {
    let done = run(&loaded(&bank(&[SLEEP]), "nap"), bytes(1));
    assert!(done.result.is_ok());
    let tree = done.recorder.finish();
    for (stage, at_least) in [("preprocessing", 0.001), ("inference", 0.002), ("postprocessing", 0.001)] {
        let taken = tree.find(&[stage]).and_then(|(_, node)| node.measure.value()).expect("is recorded");
        assert!(taken >= at_least, "{stage}: {taken}");
    }
    assert!(tree.find(&["queue"]).is_some());
}

#[test]
fn shutdown_does_not_wait_for_long_computation() {
    let bank = bank(&[ECHO, SLEEP, "name = \"long\"\nkind = \"sleep\"\ninference_ms = 86400000"]);
    for name in ["echo", "nap", "long"] {
        loaded(&bank, name);
    }
    let long = loaded(&bank, "long");
    let clock = clock();
    let recorder = Recorder::new(Arc::clone(&clock), HostId::random());
    let received_at = clock.mono();
    let reply = Box::new(|_| ());
    long.submit(Job::for_whole_answer(bytes(1), recorder, received_at, reply)).expect("the queue has room");
    // After this loop, the thread has taken the request from the queue and computes.
    while long.waiting_samples() > 0 {
        assert!(clock.mono() - received_at < Span::from_seconds(60), "no thread took the request");
        std::thread::yield_now();
    }
    let still_computing = bank.shutdown_within(Duration::from_millis(300));
    assert_eq!(still_computing, [slug("long")]);
    assert!(bank.shutdown_within(Duration::from_secs(60)).is_empty(), "no model is loaded any more");
}
