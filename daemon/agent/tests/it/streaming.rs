//! Tests of a language model on a cloud whose answer reaches the edge as partial answers.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread;

use peernet_clock::{DelaySource, Verdict};
use peernet_logger::Measure;
use peernet_stream::{IncidentKind, Outcome, PipelineState};

use crate::harness::{Aggregator, TestAgent, value};

/// Number of chunks of an answer.
const CHUNKS: usize = 5;

/// Reads a request to its end, and returns its first line, such as `POST /v1/chat/completions HTTP/1.1`. Returns `None`
/// if the client has closed the connection.
fn read_request(stream: &mut BufReader<TcpStream>) -> Option<String> {
    let (mut first_line, mut length) = (String::new(), 0);
    loop {
        let mut line = String::new();
        if stream.read_line(&mut line).ok()? == 0 {
            return None;
        }
        if first_line.is_empty() {
            first_line.clone_from(&line);
        }
        if let Some((name, value)) = line.split_once(':')
            && name.eq_ignore_ascii_case("content-length")
        {
            length = value.trim().parse().ok()?;
        }
        if line == "\r\n" {
            break;
        }
    }
    let mut body = vec![0; length];
    stream.read_exact(&mut body).ok()?;
    Some(first_line)
}

/// Starts a server of chat completions that sends [`CHUNKS`] chunks and then `end`, the end of the stream. If `end` is
/// `None`, the stream does not end, and the receiver gets a message when a client closes the connection.
fn start_server(end: Option<&'static str>) -> (SocketAddr, Receiver<()>) {
    serve(TcpListener::bind("127.0.0.1:0").expect("a port is free"), end)
}

fn serve(listener: TcpListener, end: Option<&'static str>) -> (SocketAddr, Receiver<()>) {
    let address = listener.local_addr().expect("is bound");
    let (report_closing, closings) = sync_channel(8);
    thread::spawn(move || {
        for stream in listener.incoming().map_while(Result::ok) {
            let report_closing = report_closing.clone();
            thread::spawn(move || {
                let mut stream = BufReader::new(stream);
                let Some(request_line) = read_request(&mut stream) else { return };
                let mut output = stream.get_ref().try_clone().expect("a descriptor is free");
                if !request_line.starts_with("POST") {
                    let _ = output.write_all(b"HTTP/1.1 404 Not Found\r\ncontent-length: 0\r\n\r\n");
                    return;
                }
                let head = "HTTP/1.1 200 OK\r\ncontent-type: text/event-stream\r\nconnection: close\r\n\r\n";
                let chunk = |number| {
                    format!("data: {{\"choices\":[{{\"delta\":{{\"content\":\"w{number} \"}}}}]}}\n\n")
                };
                let text: String = (0..CHUNKS).map(chunk).collect();
                output.write_all(format!("{head}{text}").as_bytes()).expect("the client reads");
                if let Some(end) = end {
                    let _ = output.write_all(end.as_bytes());
                } else if read_request(&mut stream).is_none() {
                    let _ = report_closing.send(());
                }
            });
        }
    });
    (address, closings)
}

fn cloud_tables(server: SocketAddr) -> String {
    format!(
        "[serve]\nlisten = 'tcp://127.0.0.1:0'\n\
         [[model]]\nname = 'chat'\nkind = 'openai'\nurl = 'http://{server}/v1'\nmodel = 'm'\nprompt = 'Count.'\n"
    )
}

fn edge_tables(cloud: &TestAgent, keys: &str) -> String {
    format!(
        "[[pipeline]]\nname = 'line'\nsensor = {{ kind = 'text', length = 20 }}\n\
         placement = {{ kind = 'remote', peer = '{}', model = 'chat' }}\n\
         warm_up = {{ iterations = 0 }}\nlimit = {{ iterations = 3 }}\n{keys}",
        cloud.address()
    )
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn pipeline_waits_for_server_of_its_model() {
    let address =
        TcpListener::bind("127.0.0.1:0").and_then(|free| free.local_addr()).expect("a port is free");
    let aggregator = Aggregator::start().await;
    let tables = format!(
        "[[model]]\nname = 'chat'\nkind = 'openai'\nurl = 'http://{address}/v1'\nmodel = 'm'\nprompt = 'Count.'\n\
         [[pipeline]]\nname = 'line'\nsensor = {{ kind = 'text', length = 20 }}\n\
         placement = {{ kind = 'local', model = 'chat' }}\n\
         warm_up = {{ iterations = 0 }}\nlimit = {{ iterations = 2 }}\n"
    );
    let agent = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    let state = agent.until_state(|state| matches!(state, PipelineState::Waiting(_))).await;
    let PipelineState::Waiting(reason) = state else { unreachable!("the pipeline waits") };
    assert!(reason.contains(&address.to_string()) && reason.contains("start the server"), "{reason}");
    let end = "data: {\"choices\":[{\"delta\":{},\"finish_reason\":\"stop\"}]}\n\ndata: [DONE]\n\n";
    let (_, _closings) = serve(TcpListener::bind(address).expect("the port is still free"), Some(end));
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert!(received_events.iterations().iter().all(|iteration| iteration.outcome == Outcome::Ok));
    // The unreachable server is reported once, as a disconnection before the run.
    assert_eq!(
        (received_events.iterations().len(), received_events.incidents(IncidentKind::Disconnected).len()),
        (2, 1)
    );
    let connected = received_events.incidents(IncidentKind::Connected);
    assert!(
        connected.iter().any(|incident| incident.text.contains("its server answers now")),
        "{connected:?}"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn first_part_of_answer_is_timed_across_network() {
    let end = "data: {\"choices\":[{\"delta\":{},\"finish_reason\":\"stop\"}]}\n\ndata: [DONE]\n\n";
    let (server, _closings) = start_server(Some(end));
    let aggregator = Aggregator::start().await;
    let cloud = TestAgent::start("cloud", None, &cloud_tables(server)).await;
    let edge = TestAgent::start("edge", Some(&aggregator.address), &edge_tables(&cloud, "")).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_eq!(received_events.iterations().len(), 3);
    for iteration in received_events.iterations() {
        assert_eq!(iteration.outcome, Outcome::Ok);
        let tree = &iteration.tree;
        assert_eq!(value(tree, "parts"), Some(CHUNKS as f64));
        let seconds = |name| value(tree, name).unwrap_or_else(|| panic!("{name} in {tree:?}"));
        let (_, node) = tree.find(&["inference", "time-to-first-token"]).expect("is recorded");
        let at_cloud = node.measure.value().expect("is known");
        assert!(seconds("first-part") > at_cloud, "the network and the queue are added");
        assert!(seconds("first-part") < seconds("total"));
        let (_, node) = tree.find(&["first-part-download"]).expect("is recorded");
        let Measure::Transit(transit) = &node.measure else { panic!("{node:?}") };
        let delay = transit.delay.expect("is judged");
        assert_eq!((delay.source, delay.verdict), (DelaySource::SameClock, Verdict::Ok));
        assert!(delay.value.is_some_and(|delay| !delay.is_negative()));
    }
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn timeout_at_edge_stops_language_model() {
    let (server, closings) = start_server(None);
    let aggregator = Aggregator::start().await;
    let cloud = TestAgent::start("cloud", None, &cloud_tables(server)).await;
    let tables = edge_tables(&cloud, "timeout_ms = 200");
    let edge = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    assert_eq!(received_events.iterations().len(), 3);
    assert!(received_events.iterations().iter().all(|it| matches!(it.outcome, Outcome::Timeout(_))));
    // The connection to the server is closed long before the time limits of the model.
    let closing = tokio::task::spawn_blocking(move || closings.recv().expect("the server runs"));
    tokio::time::timeout(std::time::Duration::from_secs(8), closing)
        .await
        .expect("the connection to the server is closed in time")
        .expect("does not panic");
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}
