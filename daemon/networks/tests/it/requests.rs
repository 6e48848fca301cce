//! Tests of requests and answers.

use std::time::Duration;

use peernet_clock::Span;
use peernet_logger::{HostIndex, Measure, NodeId, Unit, stage};
use peernet_networks::{
    AwaitedEvent, Failure, PartialAnswerSender, RequestCancelled, RequestError, SessionSettings,
};
use peernet_sample::{Description, Part, Sample};
use peernet_stream::{Release, VersionRange};

use crate::support::{
    Cloud, TIME_LIMIT, TestNetwork, clock, echo, over_every_network, recorder, request, sample, settings,
    text, unused_address, within,
};

over_every_network!(
    full_tree_still_gets_transits_and_sizes,
    tree_returns_with_both_hosts_and_transits,
    answers_out_of_order_reach_their_requests,
    failures_return_with_reason_and_measurements,
    request_is_cancelled_after_its_timeout,
    late_answer_of_older_version_is_counted,
    abandoned_request_frees_its_slot,
    requests_beyond_smaller_limit_wait_in_send_queue,
    too_large_sample_or_answer_leaves_session_open,
    samples_beyond_header_limits_leave_session_open
);

async fn full_tree_still_gets_transits_and_sizes(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let (session, _) = cloud.session(settings()).await;
    let mut full_recorder = recorder();
    while full_recorder.record_value("chatter".into(), 1.0, Unit::NONE) != NodeId::SKIPPED {}
    let pending =
        tokio::spawn(async move { session.request(full_recorder, &sample("hello"), TIME_LIMIT).await });
    let incoming = cloud.next_request().await;
    incoming.reply.send(incoming.recorder, Ok(sample("answer")));
    let completed = within(pending).await.expect("no panic");
    assert_eq!(completed.result.as_ref().map(text), Ok("answer"));
    let tree = completed.recorder.tree();
    for name in [stage::UPLOAD, stage::DOWNLOAD, stage::UPLOAD_BYTES, stage::DOWNLOAD_LOGGER_BYTES] {
        assert!(tree.find(&[name.as_str()]).is_some(), "{name}");
    }
}

async fn tree_returns_with_both_hosts_and_transits(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let (session, id) = cloud.session(settings()).await;
    let statistics_at_opening = session.statistics();
    let two_parts = Sample {
        parts: vec![
            Part { description: Description::bytes(), bytes: vec![7; 200_000].into() },
            Part { description: Description::bytes(), bytes: vec![8; 10].into() },
        ],
        source: "part-7.jpg".into(),
        label: Some("good".into()),
    };
    let mut edge_recorder = recorder();
    edge_recorder.time(stage::SENSING);
    let edge_host = edge_recorder.tree().anchors()[0].host;
    let pending = tokio::spawn({
        let (session, two_parts) = (session.clone(), two_parts.clone());
        async move { session.request(edge_recorder, &two_parts, TIME_LIMIT).await }
    });

    let mut incoming = cloud.next_request().await;
    assert_eq!(incoming.session, id);
    assert_eq!(incoming.sample, two_parts);
    let (upload, _) = incoming.recorder.tree().find(&["upload"]).expect("closed on arrival");
    incoming.recorder.record_timer(
        stage::QUEUE,
        incoming.received.mono,
        incoming.received.mono + Span::from_micros(3),
    );
    incoming.recorder.time(stage::INFERENCE);
    incoming.reply.send(incoming.recorder, Ok(sample("answer")));

    let completed = within(pending).await.expect("no panic");
    assert_eq!(completed.result.as_ref().map(text), Ok("answer"));
    let tree = completed.recorder.tree();
    let anchors: Vec<_> = tree.anchors().iter().map(|anchor| anchor.host).collect();
    assert_eq!(anchors, [edge_host, cloud.host]);
    assert_eq!(completed.upload, Some(upload));
    let (download_id, download) = tree.find(&["download"]).expect("the answer's transit");
    assert_eq!(completed.download, Some(download_id));
    assert_eq!(download.host, HostIndex(1));
    let (_, inference) = tree.find(&["inference"]).expect("the cloud's node");
    assert_eq!((inference.host, inference.parent), (HostIndex(1), Some(NodeId::ROOT)));
    assert!(download.start >= inference.start, "{:?} {:?}", download.start, inference.start);
    let (_, encode) = tree.find(&["encode"]).expect("on the edge");
    assert!(!encode.measure.is_open());

    let transit = |node: NodeId| match &tree.get(node).expect("in the tree").measure {
        Measure::Transit(transit) => (transit.sent, transit.received.expect("arrived")),
        other => panic!("{other:?}"),
    };
    let ((sent, received), (answered, arrived)) = (transit(upload), transit(download_id));
    assert_eq!(received, incoming.received.wall);
    assert_eq!(Some(arrived), completed.arrived_at.map(|stamp| stamp.wall));
    assert!(sent <= received && received <= answered && answered <= arrived);

    let value = |name| tree.find(&[name]).and_then(|(_, node)| node.measure.value()).expect(name);
    assert_eq!(value("upload-bytes"), 200_010.0);
    assert_eq!(value("download-bytes"), 6.0);
    let logger_bytes = value("upload-logger-bytes") + value("download-logger-bytes");
    let (sent, received) = (session.statistics().sent, session.statistics().received);
    let bytes =
        sent.bytes - statistics_at_opening.sent.bytes + received.bytes - statistics_at_opening.received.bytes;
    assert_eq!(bytes, 200_016 + logger_bytes as u64);
    assert_eq!((statistics_at_opening.sent.messages, statistics_at_opening.received.messages), (1, 1));
    assert_eq!((sent.messages, received.messages), (2, 2));
}

async fn answers_out_of_order_reach_their_requests(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let (session, _) = cloud.session(settings()).await;
    let pending: Vec<_> = (0..50).map(|number| request(&session, &number.to_string(), TIME_LIMIT)).collect();
    let mut incoming = Vec::new();
    for _ in 0..pending.len() {
        incoming.push(cloud.next_request().await);
    }
    // A model's worker is a plain thread.
    let worker = std::thread::spawn(move || {
        for request in incoming.into_iter().rev() {
            request.reply.send(request.recorder, Ok(request.sample));
        }
    });
    for (number, pending) in pending.into_iter().enumerate() {
        let completed = within(pending).await.expect("no panic");
        assert_eq!(completed.result.as_ref().map(text), Ok(number.to_string().as_str()));
    }
    worker.join().expect("no panic");
}

async fn failures_return_with_reason_and_measurements(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let (session, _) = cloud.session(settings()).await;

    // A timeout that the clock cannot represent does not end the request early.
    let pending = request(&session, "broken picture", Duration::MAX);
    let mut incoming = cloud.next_request().await;
    incoming.recorder.time(stage::PREPROCESSING);
    incoming.reply.send(incoming.recorder, Err(Failure::Failed("not a JPEG".into())));
    let completed = within(pending).await.expect("no panic");
    assert_eq!(completed.result, Err(RequestError::Failed("not a JPEG".into())));
    assert!(completed.download.is_some() && completed.recorder.tree().find(&["preprocessing"]).is_some());

    let pending = request(&session, "one too many", TIME_LIMIT);
    let incoming = cloud.next_request().await;
    incoming.reply.send(incoming.recorder, Err(Failure::Overloaded("16 samples wait".into())));
    let completed = within(pending).await.expect("no panic");
    assert_eq!(completed.result, Err(RequestError::Overloaded("16 samples wait".into())));

    let pending = request(&session, "forgotten", TIME_LIMIT);
    drop(cloud.next_request().await);
    let completed = within(pending).await.expect("no panic");
    assert!(matches!(completed.result, Err(RequestError::Failed(_))), "{:?}", completed.result);
    // The reply to a dropped request has no departure, so there is no download.
    assert!(completed.arrived_at.is_some() && completed.download.is_none());
    echo(&mut cloud, &session, "all is well").await;
}

/// Waits on a thread until a request is cancelled.
async fn wait_until_cancelled(partial_answers: PartialAnswerSender) {
    let waiting = tokio::task::spawn_blocking(move || partial_answers.wait(TIME_LIMIT));
    assert_eq!(within(waiting).await.expect("no panic"), Err(RequestCancelled));
}

async fn request_is_cancelled_after_its_timeout(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let (session, _) = cloud.session(settings()).await;
    let pending = request(&session, "slow", Duration::from_millis(30));
    let slow_request = cloud.next_request().await;
    assert_eq!(
        within(pending).await.expect("no panic").result,
        Err(RequestError::Timeout(AwaitedEvent::Answer))
    );
    // The listener handles the cancellation while it waits for the next request.
    let next = request(&session, "next", TIME_LIMIT);
    let incoming = cloud.next_request().await;
    wait_until_cancelled(slow_request.partial_answers).await;
    slow_request.reply.send(slow_request.recorder, Ok(slow_request.sample));
    incoming.reply.send(incoming.recorder, Ok(incoming.sample));
    assert_eq!(within(next).await.expect("no panic").result.as_ref().map(text), Ok("next"));
    let statistics = session.statistics();
    assert_eq!((statistics.late_messages, statistics.lost_messages), (0, 0), "the answer was not sent");
    assert_eq!(cloud.listener.statistics().lost_messages, 0);
}

async fn late_answer_of_older_version_is_counted(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let before_cancellation = VersionRange::new(4, 5, Release(0, 1, 0));
    let session = cloud.session_with_clock(clock(), before_cancellation).await;
    let pending = request(&session, "slow", Duration::from_millis(30));
    let slow_request = cloud.next_request().await;
    let completed = within(pending).await.expect("no panic");
    assert_eq!(completed.result, Err(RequestError::Timeout(AwaitedEvent::Answer)));
    assert_eq!((completed.arrived_at, completed.download), (None, None));
    let upload = completed.recorder.tree().get(completed.upload.expect("was sent")).expect("in the tree");
    assert!(upload.measure.is_open());
    assert!(completed.recorder.tree().find(&["upload-bytes"]).is_some());

    slow_request.reply.send(slow_request.recorder, Ok(slow_request.sample));
    // The next answer arrives after the late answer.
    echo(&mut cloud, &session, "next").await;
    assert_eq!(session.statistics().late_messages, 1);
    assert_eq!(session.statistics().lost_messages, 0);
}

async fn abandoned_request_frees_its_slot(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let one_in_flight = SessionSettings { max_in_flight: 1, ..settings() };
    let (session, _) = cloud.session(one_in_flight).await;
    let pending = request(&session, "dropped", TIME_LIMIT);
    let dropped = cloud.next_request().await;
    pending.abort();
    assert!(within(pending).await.expect_err("aborted").is_cancelled());
    echo(&mut cloud, &session, "next").await;
    wait_until_cancelled(dropped.partial_answers).await;
    dropped.reply.send(dropped.recorder, Ok(dropped.sample));
    echo(&mut cloud, &session, "last").await;
    assert_eq!(session.statistics().late_messages, 0);
}

async fn requests_beyond_smaller_limit_wait_in_send_queue(network: TestNetwork) {
    let one_in_flight = SessionSettings { max_in_flight: 1, ..settings() };
    let mut cloud = Cloud::start_at(&unused_address(network), one_in_flight).await;
    let (session, _) = cloud.session(settings()).await;
    let (first, second) = (request(&session, "a", TIME_LIMIT), request(&session, "b", TIME_LIMIT));
    for _ in 0..2 {
        let incoming = cloud.next_request().await;
        incoming.reply.send(incoming.recorder, Ok(incoming.sample));
    }
    let (first, second) = (within(first).await.expect("no panic"), within(second).await.expect("no panic"));
    assert!(first.result.is_ok() && second.result.is_ok());
    let has_waited = |completed: &peernet_networks::CompletedRequest| {
        completed.recorder.tree().find(&["send-queue"]).is_some()
    };
    assert_eq!([has_waited(&first), has_waited(&second)].iter().filter(|has_waited| **has_waited).count(), 1);

    let first_request = request(&session, "c", TIME_LIMIT);
    let incoming = cloud.next_request().await;
    let completed = within(request(&session, "d", Duration::from_millis(20))).await.expect("no panic");
    assert_eq!(completed.result, Err(RequestError::Timeout(AwaitedEvent::Slot)));
    assert_eq!(completed.upload, None);
    incoming.reply.send(incoming.recorder, Ok(incoming.sample));
    assert!(within(first_request).await.expect("no panic").result.is_ok());
}

async fn too_large_sample_or_answer_leaves_session_open(network: TestNetwork) {
    let small_limit = SessionSettings { max_message_bytes: 100_000, ..settings() };
    let mut cloud = Cloud::start_at(&unused_address(network), small_limit.clone()).await;
    let (session, _) = cloud.session(settings()).await;
    let oversized_sample = Sample::from_part(Description::bytes(), vec![0; 100_001].into());
    let completed = within(session.request(recorder(), &oversized_sample, TIME_LIMIT)).await;
    let Err(RequestError::Failed(reason)) = &completed.result else { panic!("{:?}", completed.result) };
    assert!(reason.contains("max_message_bytes"), "{reason}");
    assert_eq!(completed.upload, None);
    echo(&mut cloud, &session, "small").await;

    let mut cloud = Cloud::on_network(network).await;
    let (session, _) = cloud.session(small_limit).await;
    let pending = request(&session, "zoom in", TIME_LIMIT);
    let incoming = cloud.next_request().await;
    incoming.reply.send(incoming.recorder, Ok(oversized_sample));
    let completed = within(pending).await.expect("no panic");
    let Err(RequestError::Failed(reason)) = &completed.result else { panic!("{:?}", completed.result) };
    assert!(reason.contains("max_message_bytes"), "{reason}");
    echo(&mut cloud, &session, "small").await;
}

async fn samples_beyond_header_limits_leave_session_open(network: TestNetwork) {
    let mut cloud = Cloud::on_network(network).await;
    let (session, _) = cloud.session(settings()).await;
    let part = Part { description: Description::bytes(), bytes: "x".into() };
    let sample_with_many_parts = Sample { parts: vec![part; 65], source: String::new(), label: None };
    let sample_with_long_source = Sample { source: "x".repeat(70_000), ..sample("x") };
    for invalid_sample in [sample_with_many_parts, sample_with_long_source] {
        let completed = within(session.request(recorder(), &invalid_sample, TIME_LIMIT)).await;
        assert!(matches!(completed.result, Err(RequestError::Failed(_))), "{:?}", completed.result);
    }
    let sample_without_parts = Sample { parts: Vec::new(), source: String::new(), label: None };
    let pending = tokio::spawn({
        let (session, sample_without_parts) = (session.clone(), sample_without_parts.clone());
        async move { session.request(recorder(), &sample_without_parts, TIME_LIMIT).await }
    });
    let incoming = cloud.next_request().await;
    incoming.reply.send(incoming.recorder, Ok(incoming.sample));
    assert_eq!(within(pending).await.expect("no panic").result, Ok(sample_without_parts));
}
