//! A listener that closes in good order.

use peernet_networks::{CloseReason, RequestError, SessionSettings};

use crate::support::{Cloud, PATIENCE, request, settings, text, within};

#[tokio::test]
async fn closing_waits_for_answers_and_says_goodbye() {
    let mut cloud = Cloud::start().await;
    let (session, _) = cloud.session(settings()).await;
    let pending = request(&session, "almost done", PATIENCE);
    let incoming = cloud.next_request().await;
    let (closing, closed) = tokio::sync::oneshot::channel();
    let listener = cloud.listener;
    let close = tokio::spawn(async move {
        closing.send(()).expect("waited for");
        listener.close().await;
    });
    within(closed).await.expect("the listener closes");
    incoming.reply.send(incoming.log, Ok(incoming.sample));
    let exchange = within(pending).await.expect("no panic");
    assert_eq!(exchange.result.as_ref().map(text), Ok("almost done"));
    assert_eq!(within(session.closed()).await, CloseReason::Goodbye("the cloud shuts down".into()));
    within(close).await.expect("no panic");
}

#[tokio::test]
async fn closing_does_not_wait_for_ever() {
    let hasty = SessionSettings { close_timeout_ms: 50, ..settings() };
    let mut cloud = Cloud::start_at("tcp://127.0.0.1:0", hasty).await;
    let (session, _) = cloud.session(settings()).await;
    let pending = request(&session, "never done", PATIENCE);
    let _unanswered = cloud.next_request().await;
    within(cloud.listener.close()).await;
    let exchange = within(pending).await.expect("no panic");
    let Err(RequestError::Lost(reason)) = exchange.result else { panic!("{:?}", exchange.result) };
    assert!(reason.contains("shuts down"), "{reason}");
}
