use std::sync::Barrier;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use bytes::Bytes;
use peernet_clock::{ClockIdentity, ManualClock, Span, WallTime};
use peernet_logger::{HostId, Recorder, stage};
use peernet_sample::{Description, Sample};
use tokio_util::sync::CancellationToken;

use super::*;
use crate::model::echo::{Echo, EchoConfig};
use crate::{Cancelled, PartialAnswerError, Requester, Worker};

type Compute = dyn Fn(&Sample) -> Result<Sample, InferenceError> + Send + Sync;

/// Model that runs a function of the test.
struct TestModel(Arc<Compute>);

impl Model for TestModel {
    fn create_worker(&self) -> Result<Box<dyn Worker>, LoadError> {
        Ok(Box::new(TestModel(Arc::clone(&self.0))))
    }

    fn device(&self) -> String {
        "cpu".to_owned()
    }

    fn facts(&self) -> Vec<(String, String)> {
        Vec::new()
    }
}

impl Worker for TestModel {
    fn infer(
        &mut self,
        sample: &Sample,
        recorder: &mut Recorder,
        _requester: &dyn Requester,
    ) -> Result<Sample, InferenceError> {
        let _inference = recorder.time(stage::INFERENCE);
        (self.0)(sample)
    }
}

fn clock() -> Arc<ManualClock> {
    Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "clock")))
}

fn pool(
    workers: usize,
    queue: usize,
    compute: impl Fn(&Sample) -> Result<Sample, InferenceError> + Send + Sync + 'static,
) -> Arc<Pool> {
    start(Arc::new(TestModel(Arc::new(compute))), Sizes { workers, queue }, clock())
}

fn start(model: Arc<dyn Model>, sizes: Sizes, clock: Arc<ManualClock>) -> Arc<Pool> {
    let name = "test".parse().expect("is a name");
    let clock: SharedClock = clock;
    Arc::new(Pool::start(name, model, sizes, &clock, clock.mono()).expect("starts"))
}

fn sample(text: &'static str) -> Sample {
    Sample::from_part(Description::bytes(), Bytes::from(text))
}

fn job(text: &'static str, reply: impl FnOnce(FinishedJob) + Send + 'static) -> Job {
    let recorder = Recorder::new(clock(), HostId::random());
    Job::for_whole_answer(sample(text), recorder, MonoTime::from_nanos(0), Box::new(reply))
}

/// Creates a job and the receiver of its result.
fn job_with_receiver(text: &'static str) -> (Job, Receiver<FinishedJob>) {
    let (sender, receiver) = sync_channel(1);
    (job(text, move |done| sender.send(done).expect("the test waits for the result")), receiver)
}

fn run(pool: &Pool, text: &'static str) -> FinishedJob {
    let (job, receiver) = job_with_receiver(text);
    pool.submit(job).expect("has room");
    receiver.recv().expect("is answered")
}

/// Returns a computation that sends a message when it begins, and then waits until the test releases it. Returns the
/// receiver of the messages and the sender that releases one computation.
fn gated_computation()
-> (impl Fn(&Sample) -> Result<Sample, InferenceError> + Send + Sync, Receiver<()>, SyncSender<()>) {
    let (begin_sender, begins) = sync_channel(8);
    let (release, gate) = sync_channel::<()>(8);
    let gate = Mutex::new(gate);
    let compute = move |sample: &Sample| {
        begin_sender.send(()).expect("the test waits for the beginning");
        gate.lock().expect("is not poisoned").recv().expect("the test releases the computation");
        Ok(sample.clone())
    };
    (compute, begins, release)
}

#[test]
fn wait_for_a_worker_is_recorded() {
    let clock = clock();
    let model = Arc::new(TestModel(Arc::new(|sample| Ok(sample.clone()))));
    let pool = start(model, Sizes { workers: 1, queue: 1 }, Arc::clone(&clock));
    clock.advance(Span::from_millis(7));
    let done = run(&pool, "a");
    assert_eq!(done.result, Ok(sample("a")));
    let tree = done.recorder.finish();
    assert_eq!(tree.find(&["queue"]).expect("is recorded").1.measure.value(), Some(0.007));
    assert!(tree.find(&["inference"]).is_some());
}

#[test]
fn full_queue_returns_the_job() {
    let (compute, begins, release) = gated_computation();
    let pool = pool(1, 1, compute);
    let (first, first_done) = job_with_receiver("first");
    pool.submit(first).expect("a worker is free");
    begins.recv().expect("the worker began");
    let (second, second_done) = job_with_receiver("second");
    pool.submit(second).expect("the queue has room");
    assert_eq!(pool.waiting_samples(), 1);
    let refused = pool.submit(job_with_receiver("third").0).expect_err("the queue is full");
    assert_eq!(refused.job.sample, sample("third"));
    assert_eq!(refused.reason, InferenceError::QueueFull { model: "test".to_owned(), capacity: 1 });
    for done in [first_done, second_done] {
        release.send(()).expect("a worker waits");
        assert!(done.recv().expect("is answered").result.is_ok());
    }
}

/// Requester whose request the test cancels with a token.
struct CancellableRequester(CancellationToken);

impl Requester for CancellableRequester {
    fn send_partial_answer(&self, _partial_answer: Sample) -> Result<(), PartialAnswerError> {
        Ok(())
    }

    fn cancellation(&self) -> CancellationToken {
        self.0.clone()
    }

    fn wait(&self, _duration: Duration) -> Result<(), Cancelled> {
        Ok(())
    }
}

#[test]
fn worker_that_ignores_cancellation_is_logged_once() {
    let (compute, begins, release) = gated_computation();
    let clock = clock();
    let pool = start(Arc::new(TestModel(Arc::new(compute))), Sizes { workers: 2, queue: 4 }, clock.clone());
    let tokens = [CancellationToken::new(), CancellationToken::new()];
    for token in &tokens {
        let job = Job { requester: Arc::new(CancellableRequester(token.clone())), ..job("long", |_| {}) };
        pool.submit(job).expect("has room");
        begins.recv().expect("begins");
    }
    tokens[0].cancel();
    assert_eq!(pool.blocked_for(), None, "the request of the second worker is not cancelled");
    tokens[1].cancel();
    clock.advance(Span::from_millis(600));
    assert_eq!(pool.blocked_for(), Some(Span::from_millis(600)));
    let Execution::Threads { blockage, .. } = &pool.execution else {
        panic!("the test model runs on threads")
    };
    let mut logged = Vec::new();
    for _ in 0..4 {
        logged.push(blockage.check(pool.name()));
        clock.advance(Span::from_millis(600));
    }
    // The first check notices the blockage. The third check is 1.2 s later, which exceeds the grace period of 1 s.
    assert_eq!(logged, [false, false, true, false]);
    let (next, done) = job_with_receiver("next");
    pool.submit(next).expect("has room");
    (0..3).for_each(|_| release.send(()).expect("a computation waits"));
    done.recv().expect("is answered").result.expect("is computed");
    pool.shutdown();
    assert_eq!(pool.blocked_for(), None);
}

#[test]
fn cancelled_request_gives_up_its_place_in_full_queue() {
    let (compute, begins, release) = gated_computation();
    let pool = pool(1, 1, compute);
    let (first, first_done) = job_with_receiver("first");
    pool.submit(first).expect("a worker is free");
    begins.recv().expect("the worker began");
    let (mut second, second_done) = job_with_receiver("second");
    let token = CancellationToken::new();
    second.requester = Arc::new(CancellableRequester(token.clone()));
    pool.submit(second).expect("the queue has room");
    token.cancel();
    let (third, third_done) = job_with_receiver("third");
    pool.submit(third).expect("the place of the second is free");
    let cancelled = Err(InferenceError::Cancelled { model: "test".to_owned() });
    assert_eq!(second_done.recv().expect("is answered").result, cancelled);
    for done in [first_done, third_done] {
        release.send(()).expect("a worker waits");
        assert!(done.recv().expect("is answered").result.is_ok());
    }
}

#[test]
fn workers_compute_at_the_same_time() {
    let both_workers = Barrier::new(2);
    let pool = pool(2, 2, move |sample| {
        both_workers.wait();
        Ok(sample.clone())
    });
    let (a, a_done) = job_with_receiver("a");
    let (b, b_done) = job_with_receiver("b");
    pool.submit(a).expect("has room");
    pool.submit(b).expect("has room");
    assert!(a_done.recv().expect("is answered").result.is_ok());
    assert!(b_done.recv().expect("is answered").result.is_ok());
}

#[test]
fn panic_fails_only_the_current_sample() {
    let pool = pool(1, 4, |sample| {
        assert!(&sample.parts[0].bytes[..] != b"bad", "cannot take {}", "this");
        Ok(sample.clone())
    });
    let done = run(&pool, "bad");
    let message = "cannot take this".to_owned();
    assert_eq!(done.result, Err(InferenceError::Panicked { model: "test".to_owned(), message }));
    let tree = done.recorder.finish();
    assert!(!tree.find(&["inference"]).expect("was begun").1.measure.is_open());
    let done = run(&pool, "good");
    assert_eq!(done.result, Ok(sample("good")));
    assert!(done.recorder.finish().find(&["restart"]).is_some(), "the worker was rebuilt after the panic");
    assert!(run(&pool, "good").recorder.finish().find(&["restart"]).is_none());
}

#[test]
fn reply_that_panics_leaves_the_pool_working() {
    let pool = pool(1, 4, |sample| Ok(sample.clone()));
    pool.submit(job("a", |_| panic!("the receiver is broken"))).expect("has room");
    assert_eq!(run(&pool, "b").result, Ok(sample("b")));
}

#[test]
fn shutdown_answers_all_jobs() {
    let (compute, begins, release) = gated_computation();
    let pool = pool(1, 4, compute);
    let (running, running_done) = job_with_receiver("running");
    pool.submit(running).expect("has room");
    begins.recv().expect("the worker began");
    let (waiting, waiting_done) = job_with_receiver("waiting");
    pool.submit(waiting).expect("has room");

    let ending = std::thread::spawn({
        let pool = Arc::clone(&pool);
        move || pool.shutdown()
    });
    let stopped = Err(InferenceError::Stopped { model: "test".to_owned() });
    assert_eq!(waiting_done.recv().expect("is answered").result, stopped);
    let refused = pool.submit(job_with_receiver("late").0).expect_err("is shut down");
    assert_eq!(Err(refused.reason), stopped);
    release.send(()).expect("the worker waits");
    assert_eq!(running_done.recv().expect("is answered").result, Ok(sample("running")));
    ending.join().expect("does not panic");
}

#[test]
fn last_handle_may_be_dropped_on_pool_thread() {
    let (compute, begins, release) = gated_computation();
    let pool = pool(1, 1, compute);
    let (sender, receiver) = sync_channel(1);
    let handle = Arc::clone(&pool);
    pool.submit(job("a", move |_| {
        drop(handle);
        sender.send(()).expect("the test waits for the reply");
    }))
    .expect("has room");
    begins.recv().expect("the worker began");
    drop(pool);
    release.send(()).expect("the worker waits");
    receiver.recv().expect("the reply returned");
}

#[test]
fn echo_answers_on_thread_of_caller() {
    let pool = start(Arc::new(Echo::new(EchoConfig::default())), Sizes { workers: 1, queue: 1 }, clock());
    let caller = thread::current().id();
    let (sender, receiver) = sync_channel(1);
    let reply = move |done: FinishedJob| sender.send((thread::current().id(), done)).expect("has room");
    pool.submit(job("abc", reply)).expect("always has room");
    let (computed_on, done) = receiver.try_recv().expect("was answered already");
    assert_eq!((computed_on, done.result), (caller, Ok(sample("abc"))));
    assert!(done.recorder.finish().find(&["queue"]).is_some());

    let (sender, receiver) = sync_channel(1);
    let same_pool = Arc::clone(&pool);
    let reply = move |_: FinishedJob| {
        same_pool
            .submit(job("b", move |done| sender.send(done).expect("has room")))
            .expect("a reply may submit a job");
    };
    pool.submit(job("a", reply)).expect("always has room");
    assert_eq!(receiver.try_recv().expect("was answered already").result, Ok(sample("b")));
}
