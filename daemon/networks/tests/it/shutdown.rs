//! Tests of a listener that closes.

use std::sync::{Arc, Mutex, mpsc};
use std::thread;
use std::time::Duration;

use peernet_clock::{Clock, ClockIdentity, MonoTime, RawTime, SharedClock, WallTime};
use peernet_networks::{CloseReason, RequestError, SessionSettings};
use tokio::sync::oneshot;

use crate::support::{
    Cloud, TIME_LIMIT, TestNetwork, clock, over_every_network, request, settings, text, unused_address,
    within,
};

over_every_network!(closing_waits_for_answers_and_sends_goodbye, closing_ends_after_timeout);

/// Name of the thread that a [`PausingClock`] stops.
const PAUSED_THREAD: &str = "paused";

/// A clock that stops one thread once, when the thread reads the clock. The clock signals that the thread has arrived,
/// and lets the thread wait for permission to continue.
#[derive(Debug)]
struct PausingClock {
    clock: SharedClock,
    /// Channels that signal the arrival of the thread and receive the permission; `None` after the stop.
    gate: Mutex<Option<(oneshot::Sender<()>, mpsc::Receiver<()>)>>,
}

impl Clock for PausingClock {
    fn wall(&self) -> WallTime {
        if thread::current().name() == Some(PAUSED_THREAD)
            && let Some((arrival_sender, permission_receiver)) = self.gate.lock().expect("no panic").take()
        {
            arrival_sender.send(()).expect("waited for");
            permission_receiver.recv().expect("permission is given");
        }
        self.clock.wall()
    }

    fn mono(&self) -> MonoTime {
        self.clock.mono()
    }

    fn raw(&self) -> RawTime {
        self.clock.raw()
    }

    fn identity(&self) -> &ClockIdentity {
        self.clock.identity()
    }
}

#[tokio::test]
async fn closing_waits_for_answer_that_is_being_sent() {
    let ((arrival_sender, arrival_receiver), (permission_sender, permission_receiver)) =
        (oneshot::channel(), mpsc::sync_channel(1));
    let pausing_clock =
        PausingClock { clock: clock(), gate: Mutex::new(Some((arrival_sender, permission_receiver))) };
    let mut cloud = Cloud::start_with_clock(Arc::new(pausing_clock)).await;
    let (session, _) = cloud.session(settings()).await;
    let pending = [request(&session, "one", TIME_LIMIT), request(&session, "other", TIME_LIMIT)];
    let (slow_request, quick_request) = (cloud.next_request().await, cloud.next_request().await);
    // The model has answered the slow request, and the answer has not been sent yet.
    let paused_thread = thread::Builder::new().name(PAUSED_THREAD.to_owned());
    let paused_thread = paused_thread
        .spawn(move || slow_request.reply.send(slow_request.recorder, Ok(slow_request.sample)))
        .expect("a thread");
    within(arrival_receiver).await.expect("the thread arrives at the gate");
    let close = tokio::spawn(cloud.listener.close());
    quick_request.reply.send(quick_request.recorder, Ok(quick_request.sample));
    let result = tokio::time::timeout(Duration::from_millis(100), session.closed()).await;
    assert!(result.is_err(), "goodbye came before the answer: {result:?}");
    permission_sender.send(()).expect("waited for");
    for pending in pending {
        let completed = within(pending).await.expect("no panic");
        assert!(completed.result.is_ok(), "{:?}", completed.result);
    }
    assert_eq!(within(session.closed()).await, CloseReason::Goodbye("the cloud shuts down".into()));
    within(close).await.expect("no panic");
    paused_thread.join().expect("no panic");
}

async fn closing_waits_for_answers_and_sends_goodbye(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let (session, _) = cloud.session(settings()).await;
    let pending = request(&session, "almost done", TIME_LIMIT);
    let incoming = cloud.next_request().await;
    let (closing_sender, closing_receiver) = tokio::sync::oneshot::channel();
    let listener = cloud.listener;
    let close = tokio::spawn(async move {
        closing_sender.send(()).expect("waited for");
        listener.close().await;
    });
    within(closing_receiver).await.expect("the listener closes");
    incoming.reply.send(incoming.recorder, Ok(incoming.sample));
    let completed = within(pending).await.expect("no panic");
    assert_eq!(completed.result.as_ref().map(text), Ok("almost done"));
    assert_eq!(within(session.closed()).await, CloseReason::Goodbye("the cloud shuts down".into()));
    within(close).await.expect("no panic");
}

async fn closing_ends_after_timeout(network: TestNetwork) {
    let short_timeout = SessionSettings { close_timeout_ms: 50, ..settings() };
    let mut cloud = Cloud::start_at(&unused_address(network), short_timeout).await;
    let (session, _) = cloud.session(settings()).await;
    let pending = request(&session, "never done", TIME_LIMIT);
    let _unanswered = cloud.next_request().await;
    within(cloud.listener.close()).await;
    let completed = within(pending).await.expect("no panic");
    let Err(RequestError::Lost(reason)) = completed.result else { panic!("{:?}", completed.result) };
    assert!(reason.contains("shuts down"), "{reason}");
}
