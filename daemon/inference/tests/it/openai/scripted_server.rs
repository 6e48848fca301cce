//! Server that answers each request for a chat completion as the next script says.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread;
use std::time::Duration;

use tokio_rustls::rustls::{ServerConfig, ServerConnection, StreamOwned};

/// One step of a script. The connection is closed after the last step.
#[derive(Clone, Debug)]
pub(super) enum Step {
    /// Sends bytes.
    Send(Vec<u8>),
    /// Sends nothing for some time.
    Pause(Duration),
    /// Sends nothing until the client closes the connection.
    Stall,
}

/// Running server. Its thread ends with the test.
pub(super) struct ScriptedServer {
    address: SocketAddr,
    scheme: &'static str,
    requests: Receiver<Request>,
}

/// A request as it was received.
#[derive(Debug)]
pub(super) struct Request {
    /// Request line and headers, all in lower case.
    pub(super) head: String,
    pub(super) body: serde_json::Value,
}

impl ScriptedServer {
    /// Starts a server that follows the first script for the first request, the second script for the second request,
    /// and so on.
    pub(super) fn start(scripts: Vec<Vec<Step>>) -> Self {
        Self::start_with("http", scripts, |stream| Ok(Box::new(stream)))
    }

    /// Starts a server as [`start`](Self::start) does, but with TLS.
    pub(super) fn start_tls(scripts: Vec<Vec<Step>>, config: Arc<ServerConfig>) -> Self {
        Self::start_with("https", scripts, move |stream| Ok(Box::new(tls_stream(stream, &config)?)))
    }

    fn start_with(
        scheme: &'static str,
        scripts: Vec<Vec<Step>>,
        open: impl Fn(TcpStream) -> std::io::Result<Box<dyn Connection>> + Send + 'static,
    ) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port is free");
        let address = listener.local_addr().expect("is bound");
        let (sender, requests) = sync_channel(scripts.len().max(1));
        let mut scripts = scripts.into_iter();
        thread::spawn(move || {
            for stream in listener.incoming() {
                let stream = stream.expect("is accepted");
                stream.set_nodelay(true).expect("is a TCP socket");
                // The handshake fails if the client refuses the certificate.
                let Ok(mut stream) = open(stream) else { continue };
                let (head, body) = read_request(&mut stream);
                if head.starts_with("get /v1/models ") {
                    let answer = "HTTP/1.1 200 OK\r\nContent-Length: 11\r\n\r\n{\"data\":[]}";
                    stream.write_all(answer.as_bytes()).expect("is received");
                    continue;
                }
                let body = serde_json::from_slice(&body).expect("is JSON");
                sender.send(Request { head, body }).expect("the test is running");
                let Some(script) = scripts.next() else { return };
                for step in script {
                    if run(&mut stream, step).is_err() {
                        break;
                    }
                }
            }
        });
        Self { address, scheme, requests }
    }

    /// Returns the URL of the API.
    pub(super) fn url(&self) -> String {
        format!("{}://{}/v1", self.scheme, self.address)
    }

    /// Returns the next request.
    pub(super) fn request(&self) -> Request {
        self.requests.recv_timeout(Duration::from_secs(60)).expect("a request arrives")
    }
}

/// A connection, with TLS or without.
trait Connection: Read + Write {}

impl<T: Read + Write> Connection for T {}

/// Completes the TLS handshake of a connection.
pub(super) fn tls_stream(
    mut stream: TcpStream,
    config: &Arc<ServerConfig>,
) -> std::io::Result<StreamOwned<ServerConnection, TcpStream>> {
    let mut connection = ServerConnection::new(Arc::clone(config)).expect("is a valid configuration");
    while connection.is_handshaking() {
        connection.complete_io(&mut stream)?;
    }
    Ok(StreamOwned::new(connection, stream))
}

fn run(stream: &mut impl Connection, step: Step) -> std::io::Result<()> {
    match step {
        Step::Send(bytes) => stream.write_all(&bytes),
        Step::Pause(duration) => {
            thread::sleep(duration);
            Ok(())
        }
        Step::Stall => stream.read(&mut [0]).map(|_| ()),
    }
}

fn read_request(stream: &mut impl Read) -> (String, Vec<u8>) {
    let mut reader = BufReader::new(stream);
    let mut head = String::new();
    while !head.ends_with("\r\n\r\n") {
        assert_ne!(reader.read_line(&mut head).expect("is text"), 0, "the request is cut: {head}");
    }
    let head = head.to_ascii_lowercase();
    let length = head.lines().find_map(|line| line.strip_prefix("content-length: "));
    let mut body = vec![0; length.map_or(0, |length| length.trim().parse().expect("is a number"))];
    reader.read_exact(&mut body).expect("is complete");
    (head, body)
}

/// Returns the head of a streamed answer, whose body has HTTP chunks.
pub(super) fn head() -> Step {
    let head = "HTTP/1.1 200 OK\r\nContent-Type: text/event-stream; charset=utf-8\r\nTransfer-Encoding: chunked\r\n\r\n";
    Step::Send(head.as_bytes().to_vec())
}

/// Returns an HTTP chunk with these bytes.
pub(super) fn http_chunk(bytes: &[u8]) -> Step {
    let length = format!("{:x}\r\n", bytes.len());
    Step::Send([length.as_bytes(), bytes, b"\r\n"].concat())
}

/// Returns a server-sent event in an HTTP chunk.
pub(super) fn event(data: &str) -> Step {
    http_chunk(format!("data: {data}\n\n").as_bytes())
}

/// Returns a chunk of an answer with a text.
pub(super) fn content(text: &str) -> Step {
    event(&serde_json::json!({ "choices": [{ "index": 0, "delta": { "content": text } }] }).to_string())
}

/// Returns the event with the finish reason of an answer.
pub(super) fn finish(reason: &str) -> Step {
    event(&serde_json::json!({ "choices": [{ "delta": {}, "finish_reason": reason }] }).to_string())
}

/// Returns the event with the numbers of tokens of the request and of the answer.
pub(super) fn usage(prompt: u64, completion: u64) -> Step {
    let usage = serde_json::json!({ "prompt_tokens": prompt, "completion_tokens": completion });
    event(&serde_json::json!({ "choices": [], "usage": usage }).to_string())
}

/// Returns the end of a streamed answer.
pub(super) fn done() -> Step {
    Step::Send(b"e\r\ndata: [DONE]\n\n\r\n0\r\n\r\n".to_vec())
}

/// Returns a whole HTTP response, which is not streamed.
pub(super) fn whole_response(status: &str, headers: &str, body: &str) -> Vec<Step> {
    let length = body.len();
    vec![Step::Send(
        format!("HTTP/1.1 {status}\r\n{headers}Content-Length: {length}\r\n\r\n{body}").into_bytes(),
    )]
}

/// Returns a pause.
pub(super) fn pause(millis: u64) -> Step {
    Step::Pause(Duration::from_millis(millis))
}
