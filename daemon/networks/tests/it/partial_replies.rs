//! Tests of answers that arrive as partial answers.

use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use peernet_logger::{Measure, Tree};
use peernet_networks::{
    FIRST_PART, FIRST_PART_DOWNLOAD, IncomingRequest, PARTS, PARTS_SENT, PartialAnswerError,
    PartialAnswerHandler, RequestCancelled, RequestError, SessionSettings,
};
use peernet_stream::{Release, VersionRange};

use crate::support::{
    Cloud, TIME_LIMIT, TestNetwork, clock, echo, over_every_network, recorder, request, sample, settings,
    text, unused_address, within,
};

over_every_network!(
    more_partial_answers_than_window_arrive,
    partial_answers_wait_while_queue_is_full,
    too_large_partial_answer_is_refused_with_limit,
    edge_without_partial_replies_gets_the_whole_answer,
    end_of_session_cancels_a_waiting_model,
    partial_answers_of_incomplete_answer_are_recorded
);

/// Number of partial answers, far above the number that may be unread.
const PARTIAL_ANSWER_COUNT: usize = 300;

/// Handler that collects the texts of partial answers.
fn collector() -> (PartialAnswerHandler, Arc<Mutex<Vec<String>>>) {
    let texts = Arc::new(Mutex::new(Vec::new()));
    let handler = PartialAnswerHandler(Arc::new({
        let texts = Arc::clone(&texts);
        move |partial_answer| texts.lock().expect("no panic").push(text(partial_answer).to_owned())
    }));
    (handler, texts)
}

/// Returns the value of a node: a count, or a duration in seconds.
fn node_value(tree: &Tree, name: &str) -> Option<f64> {
    tree.find(&[name])?.1.measure.value()
}

async fn more_partial_answers_than_window_arrive(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let (session, _) = cloud.session(settings()).await;
    let (handler, texts) = collector();
    let pending = tokio::spawn({
        let session = session.clone();
        async move {
            session
                .request_with_partial_answers(recorder(), &sample("count"), TIME_LIMIT, Some(handler))
                .await
        }
    });
    let incoming = cloud.next_request().await;
    let partial_answers = incoming.partial_answers.clone();
    let sending = tokio::task::spawn_blocking(move || {
        (0..PARTIAL_ANSWER_COUNT)
            .try_for_each(|number| partial_answers.send(&sample(&format!("{number:03}"))))
    });
    // The listener must be polled, so that it reads the acknowledgements.
    let sent = tokio::select! {
        sent = within(sending) => sent.expect("no panic"),
        incoming = cloud.next() => panic!("unexpected {incoming:?}"),
    };
    assert_eq!(sent, Ok(()));
    incoming.reply.send(incoming.recorder, Ok(sample("whole")));
    let completed = within(pending).await.expect("no panic");
    assert_eq!(completed.result.as_ref().map(text), Ok("whole"));

    let mut texts = texts.lock().expect("no panic").clone();
    // Datagrams may overtake each other.
    texts.sort();
    assert_eq!(texts, (0..PARTIAL_ANSWER_COUNT).map(|number| format!("{number:03}")).collect::<Vec<_>>());
    let tree = completed.recorder.tree();
    assert_eq!(node_value(tree, PARTS.as_str()), Some(PARTIAL_ANSWER_COUNT as f64));
    assert_eq!(node_value(tree, PARTS_SENT.as_str()), Some(PARTIAL_ANSWER_COUNT as f64));
    let first_s = node_value(tree, FIRST_PART.as_str()).expect("is recorded");
    assert!(first_s > 0.0 && first_s < TIME_LIMIT.as_secs_f64(), "{first_s}");
    let (download, node) = tree.find(&[FIRST_PART_DOWNLOAD.as_str()]).expect("is recorded");
    assert_eq!(completed.first_partial_answer, Some(download));
    let Measure::Transit(transit) = &node.measure else { panic!("{node:?}") };
    let received = transit.received.expect("has arrived");
    assert!(
        received >= transit.sent && transit.raw_stamps.is_some(),
        "both ends read one clock: {transit:?}"
    );
    let whole_answer = tree.get(completed.download.expect("answered")).expect("in the tree");
    let Measure::Transit(whole_answer) = &whole_answer.measure else { panic!("{whole_answer:?}") };
    assert!(transit.sent < whole_answer.sent, "the first partial answer leaves before the whole answer");
}

async fn partial_answers_wait_while_queue_is_full(network: TestNetwork) {
    // The queue of a connection has room for as many bytes as the largest message, so one partial answer fills the
    // queue. Networks over datagrams retransmit a partial answer of this size, so none is lost.
    let (large, settings) = ("x".repeat(60_000), SessionSettings { max_message_bytes: 65_536, ..settings() });
    let mut cloud = Cloud::start_at(&unused_address(network), settings.clone()).await;
    let (session, _) = cloud.session(settings).await;
    let pending = tokio::spawn({
        let session = session.clone();
        async move { session.request_with_partial_answers(recorder(), &sample("count"), TIME_LIMIT, None).await }
    });
    let IncomingRequest { partial_answers, reply, recorder, .. } = cloud.next_request().await;
    let sending = tokio::task::spawn_blocking({
        let large = large.clone();
        move || {
            let sent = (0..PARTIAL_ANSWER_COUNT).try_for_each(|_| partial_answers.send(&sample(&large)));
            reply.send(recorder, Ok(sample(&large)));
            sent
        }
    });
    let sent = tokio::select! {
        sent = within(sending) => sent.expect("no panic"),
        incoming = cloud.next() => panic!("unexpected {incoming:?}"),
    };
    assert_eq!(sent, Ok(()));
    let completed = within(pending).await.expect("no panic");
    assert_eq!(completed.result.as_ref().map(|answer| text(answer) == large), Ok(true));
    assert_eq!(node_value(completed.recorder.tree(), PARTS.as_str()), Some(PARTIAL_ANSWER_COUNT as f64));
}

#[tokio::test]
async fn partial_answers_wait_while_edge_reads_nothing() {
    const SENT_COUNT: usize = 100;
    // The system's buffers have room for few partial answers, and the queue for one.
    let (large, settings) =
        ("x".repeat(1 << 20), SessionSettings { max_message_bytes: 2 << 20, ..settings() });
    let mut cloud = Cloud::start_at("tcp://127.0.0.1:0", settings.clone()).await;
    let (session, _) = cloud.session(settings).await;
    let (signal_sender, signal_receiver) = sync_channel::<()>(1);
    let signal_receiver = Mutex::new(Some(signal_receiver));
    // The handler runs on the task that receives messages. With the first partial answer, the handler stops this task
    // until the cloud has sent 60 partial answers or 500 ms have passed.
    let handler = PartialAnswerHandler(Arc::new(move |_| {
        if let Some(signal_receiver) = signal_receiver.lock().expect("no panic").take() {
            let _ = signal_receiver.recv_timeout(Duration::from_millis(500));
        }
    }));
    let pending = tokio::spawn({
        let session = session.clone();
        async move {
            session
                .request_with_partial_answers(recorder(), &sample("count"), TIME_LIMIT, Some(handler))
                .await
        }
    });
    let IncomingRequest { partial_answers, reply, recorder, .. } = cloud.next_request().await;
    let sending = tokio::task::spawn_blocking(move || {
        let result = (0..SENT_COUNT).try_for_each(|number| {
            partial_answers.send(&sample(&large))?;
            if number == 60 {
                // Nobody receives the signal if `send` has waited for more than the 500 ms of the handler.
                let _ = signal_sender.try_send(());
            }
            Ok::<_, PartialAnswerError>(())
        });
        reply.send(recorder, Ok(sample("whole")));
        result
    });
    let result = tokio::select! {
        result = within(sending) => result.expect("no panic"),
        incoming = cloud.next() => panic!("unexpected {incoming:?}"),
    };
    assert_eq!(result, Ok(()));
    let completed = within(pending).await.expect("no panic");
    assert_eq!(completed.result.as_ref().map(text), Ok("whole"));
    assert_eq!(node_value(completed.recorder.tree(), PARTS.as_str()), Some(SENT_COUNT as f64));
}

async fn partial_answers_of_incomplete_answer_are_recorded(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let (session, _) = cloud.session(settings()).await;
    for session_closes in [false, true] {
        let (sender, arrivals) = sync_channel(8);
        let handler = PartialAnswerHandler(Arc::new(move |_| {
            sender.send(()).expect("the test waits for partial answers");
        }));
        let timeout = if session_closes { TIME_LIMIT } else { Duration::from_secs(2) };
        let pending = tokio::spawn({
            let session = session.clone();
            async move {
                session
                    .request_with_partial_answers(recorder(), &sample("count"), timeout, Some(handler))
                    .await
            }
        });
        let incoming = cloud.next_request().await;
        for partial_answer in ["a", "b", "c"] {
            assert_eq!(incoming.partial_answers.send(&sample(partial_answer)), Ok(()));
        }
        let counting = tokio::task::spawn_blocking(move || (0..3).try_for_each(|_| arrivals.recv()));
        within(counting).await.expect("no panic").expect("three partial answers arrive");
        if session_closes {
            session.close().await;
        }
        let completed = within(pending).await.expect("no panic");
        let error = completed.result.expect_err("is incomplete");
        if session_closes {
            assert!(matches!(error, RequestError::Lost(_)), "{error}");
        } else {
            assert!(error.to_string().ends_with("after partial answer 3"), "{error}");
        }
        let tree = completed.recorder.tree();
        assert_eq!(node_value(tree, PARTS.as_str()), Some(3.0));
        let first_s = node_value(tree, FIRST_PART.as_str()).expect("is recorded");
        assert!(first_s > 0.0 && first_s < timeout.as_secs_f64(), "{first_s}");
    }
}

async fn too_large_partial_answer_is_refused_with_limit(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let (session, _) = cloud.session(SessionSettings { max_message_bytes: 65_536, ..settings() }).await;
    let pending = request(&session, "count", TIME_LIMIT);
    let incoming = cloud.next_request().await;
    // The number is larger than the window, because a refused partial answer must not count as unread.
    for _ in 0..PARTIAL_ANSWER_COUNT {
        let error = incoming.partial_answers.send(&sample(&"x".repeat(65_537))).expect_err("is too large");
        assert_eq!(error, PartialAnswerError::TooLarge { bytes: 65_537, max_bytes: 65_536 });
        assert!(error.to_string().contains("max_message_bytes"), "{error}");
    }
    assert_eq!(incoming.partial_answers.send(&sample("small")), Ok(()));
    incoming.reply.send(incoming.recorder, Ok(sample("whole")));
    let completed = within(pending).await.expect("no panic");
    assert_eq!(completed.result.as_ref().map(text), Ok("whole"));
    assert_eq!(node_value(completed.recorder.tree(), PARTS.as_str()), Some(1.0));
}

async fn edge_without_partial_replies_gets_the_whole_answer(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let session = cloud.session_with_clock(clock(), VersionRange::new(4, 5, Release(0, 1, 0))).await;
    let pending = request(&session, "count", TIME_LIMIT);
    let incoming = cloud.next_request().await;
    // The number is larger than the window, because partial answers that are not sent must not count as unread.
    for number in 0..PARTIAL_ANSWER_COUNT {
        assert_eq!(incoming.partial_answers.send(&sample(&number.to_string())), Ok(()));
    }
    incoming.reply.send(incoming.recorder, Ok(sample("whole")));
    let completed = within(pending).await.expect("no panic");
    assert_eq!(completed.result.as_ref().map(text), Ok("whole"));
    assert!(
        completed.first_partial_answer.is_none()
            && completed.recorder.tree().find(&[PARTS.as_str()]).is_none()
    );
    assert_eq!(session.statistics().malformed_messages, 0);
    echo(&mut cloud, &session, "next").await;
}

async fn end_of_session_cancels_a_waiting_model(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let (session, _) = cloud.session(settings()).await;
    let pending = request(&session, "count", TIME_LIMIT);
    let incoming = cloud.next_request().await;
    let partial_answers = incoming.partial_answers.clone();
    let waiting = tokio::task::spawn_blocking(move || partial_answers.wait(TIME_LIMIT));
    session.close().await;
    assert!(matches!(within(pending).await.expect("no panic").result, Err(RequestError::Lost(_))));
    assert!(cloud.next_closed().await.1, "the edge says goodbye");
    assert_eq!(within(waiting).await.expect("no panic"), Err(RequestCancelled));
    assert_eq!(incoming.partial_answers.send(&sample("late")), Err(RequestCancelled.into()));
}
