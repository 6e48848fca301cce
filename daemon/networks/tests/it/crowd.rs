//! Tests with many edges at the same time, on several threads.

use std::time::Duration;

use bytes::Bytes;
use peernet_networks::{Incoming, RequestError, Session};
use peernet_sample::{Description, Sample};
use tokio::task::JoinSet;

use crate::support::{Cloud, TestNetwork, accepted, hello, open, recorder, settings, within};

/// Number of edges, each with one session.
const EDGES: usize = 4;
/// Number of tasks that send requests over one session at the same time.
const TASKS_PER_EDGE: usize = 6;
/// Number of requests that a task sends one after the other.
const REQUESTS_PER_TASK: usize = 15;

/// Returns a payload whose contents depend on the seed. Sizes are above and below what the kernel accepts in one write.
fn payload(seed: usize) -> Bytes {
    let size = [10, 3_000, 70_000, 400_000][seed % 4] + seed;
    (0..size).map(|i| (i * 7 + seed) as u8).collect::<Vec<u8>>().into()
}

async fn send_requests(session: Session, task: usize) -> Result<(), RequestError> {
    for number in 0..REQUESTS_PER_TASK {
        let request = Sample::from_part(Description::bytes(), payload(task * REQUESTS_PER_TASK + number));
        let completed = session.request(recorder(), &request, Duration::from_secs(60)).await;
        assert_eq!(completed.result?, request);
        assert!(completed.download.is_some());
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn every_request_of_many_edges_is_answered() {
    serve_many_edges(TestNetwork::ZmqTcp).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn every_datagram_request_of_many_edges_is_answered() {
    serve_many_edges(TestNetwork::ZmqUdp).await;
}

async fn serve_many_edges(network: TestNetwork) {
    let Cloud { host, mut listener, .. } = Cloud::on_network(network).await;
    let address = listener.address().clone();
    let (done_sender, mut done_receiver) = tokio::sync::oneshot::channel();
    let cloud = tokio::spawn(async move {
        let mut request_count = 0;
        loop {
            let incoming = tokio::select! {
                incoming = listener.next() => incoming.expect("the listener is open"),
                _ = &mut done_receiver => break listener,
            };
            match incoming {
                Incoming::Open(open) => assert!(open.accept(accepted(host))),
                Incoming::Request(request) => {
                    request_count += 1;
                    // Answers are sent from the listening task and from other tasks alternately.
                    if request_count % 2 == 0 {
                        request.reply.send(request.recorder, Ok(request.sample));
                    } else {
                        tokio::task::spawn_blocking(move || {
                            request.reply.send(request.recorder, Ok(request.sample));
                        });
                    }
                }
                _ => {}
            }
        }
    });
    let mut tasks = JoinSet::new();
    for edge in 0..EDGES {
        let session = open(&address, hello(), settings()).await.expect("accepted");
        for task in 0..TASKS_PER_EDGE {
            tasks.spawn(send_requests(session.clone(), edge * TASKS_PER_EDGE + task));
        }
    }
    for result in within(tasks.join_all()).await {
        assert_eq!(result, Ok(()));
    }
    done_sender.send(()).expect("the cloud waits for the signal");
    let listener = within(cloud).await.expect("no panic");
    let statistics = listener.statistics();
    assert_eq!(
        (statistics.malformed_messages, statistics.late_messages, statistics.lost_messages),
        (0, 0, 0)
    );
    assert!(statistics.received.messages >= (EDGES * TASKS_PER_EDGE * REQUESTS_PER_TASK) as u64);
}
