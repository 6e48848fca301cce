//! The edge's end: the socket that a session's hello names, and the queries over its connections.

use std::convert::Infallible;
use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixListener, UnixStream as StdStream};
use std::pin::pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use peernet_clock::{Clock, SharedClock, Span, time_namespace};
use peernet_networks::{ClockSocketName, SessionId};
use peernet_probes::Key;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::UnixStream;
use uuid::Uuid;

use super::messages::ClockAnswer;
use super::proof::{AnswerResult, NotProven, OwnClock, Proof};

/// Maximum number of processes that may connect while a session is opened. The cloud is one of them; the others are not
/// part of PEERNet.
const MAX_PEERS: usize = 16;
/// Time after which a process that has not answered the first query is ignored, because it does not serve the session
/// or is stopped. After a pause of its own process, the edge waits this long for an answer before it ends an expired
/// proof.
const FIRST_ANSWER_TIMEOUT: Duration = Duration::from_millis(500);

/// The socket that a session's hello names.
#[derive(Debug)]
pub(crate) struct ClockSocket {
    name: ClockSocketName,
    listener: UnixListener,
}

impl ClockSocket {
    /// Listens at a random name. Returns `None` if this process does not read the kernel's time, or cannot listen.
    pub(crate) fn listen(clock: &dyn Clock) -> Option<Self> {
        if !clock.shows_kernel_time() {
            return None;
        }
        let mut random_bytes = [0; ClockSocketName::BYTES];
        random_bytes.copy_from_slice(&Key::random_bytes()[..ClockSocketName::BYTES]);
        let name = ClockSocketName::new(random_bytes);
        match bind(name) {
            Ok(listener) => Some(Self { name, listener }),
            Err(error) => {
                tracing::warn!(
                    "cannot listen on an abstract Unix socket: {error}; delays to clouds on this machine are estimated"
                );
                None
            }
        }
    }

    pub(crate) const fn name(&self) -> ClockSocketName {
        self.name
    }

    /// Closes the socket and returns the connections. A cloud connects before it accepts the session.
    pub(crate) fn into_peers(self, session: SessionId) -> ClockPeers {
        let mut streams = Vec::new();
        // The socket does not block: if no connection waits, `accept` returns an error.
        while let Some((stream, _)) = self.listener.accept().ok().filter(|_| streams.len() < MAX_PEERS) {
            streams.push(stream);
        }
        ClockPeers { session: Some(session), streams: Arc::new(Mutex::new(streams)) }
    }
}

fn bind(name: ClockSocketName) -> io::Result<UnixListener> {
    let listener = UnixListener::bind_addr(&SocketAddr::from_abstract_name(name.to_string())?)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// Connections of the processes that connected to a session's socket. Clones share the connections.
#[derive(Clone, Debug, Default)]
pub(crate) struct ClockPeers {
    /// Id of the session; `None` if there can be no connection.
    session: Option<SessionId>,
    streams: Arc<Mutex<Vec<StdStream>>>,
}

/// Queries the connected processes for proofs as long as the future is polled, and passes each change to `report`.
pub(crate) async fn prove(
    peers: &ClockPeers,
    clock: &SharedClock,
    report: impl Fn(Result<(), NotProven>),
) -> Infallible {
    let streams = std::mem::take(&mut *peers.streams.lock().unwrap_or_else(PoisonError::into_inner));
    let mut last_reason = NotProven::NotConnected;
    for stream in streams {
        let Some(session) = peers.session else { break };
        last_reason = match time_namespace() {
            Ok(namespace) => {
                let proof = Proof::new(*session.as_bytes(), namespace);
                let Err(reason) = Prover { proof, clock, report: &report }.run(stream).await;
                reason
            }
            Err(error) => error.into(),
        };
    }
    report(Err(last_reason));
    std::future::pending().await
}

/// Sends the queries to one of the connected processes.
struct Prover<'a, F> {
    proof: Proof,
    clock: &'a SharedClock,
    report: &'a F,
}

impl<F: Fn(Result<(), NotProven>)> Prover<'_, F> {
    /// Sends queries until the other process closes the connection, or turns out not to serve the session.
    async fn run(mut self, stream: StdStream) -> Result<Infallible, NotProven> {
        stream.set_nonblocking(true)?;
        let mut stream = UnixStream::from_std(stream)?;
        let first_answer = tokio::time::timeout(FIRST_ANSWER_TIMEOUT, self.send_query(&mut stream)).await;
        first_answer.map_err(|_| NotProven::Foreign)??;
        loop {
            let pause = self.proof.pause();
            let sleep = async {
                tokio::time::sleep(pause).await;
                Ok(())
            };
            self.wait_for(sleep).await?;
            self.send_query(&mut stream).await?;
        }
    }

    /// Sends one query and handles its answer. There is no timeout.
    async fn send_query(&mut self, stream: &mut UnixStream) -> Result<(), NotProven> {
        // Each query has a new nonce, so that an old answer is not mistaken for a new answer.
        let nonce = Uuid::new_v4().into_bytes();
        let query = self.proof.next_query(nonce, self.clock.raw()).to_bytes();
        let answer = self.wait_for(async {
            let mut answer = [0; ClockAnswer::BYTES];
            stream.write_all(&query).await?;
            stream.read_exact(&mut answer).await?;
            Ok(answer)
        });
        let answer = ClockAnswer::from_bytes(&answer.await?);
        let raw = self.clock.raw();
        let own_clock =
            OwnClock { raw, mono: self.clock.mono(), shows_kernel_time: self.clock.shows_kernel_time() };
        match self.proof.handle_answer(answer, own_clock) {
            AnswerResult::Proven => (self.report)(Ok(())),
            AnswerResult::Refuted(reason) => (self.report)(Err(reason)),
            AnswerResult::Slow => {}
            AnswerResult::Foreign => return Err(NotProven::Foreign),
        }
        Ok(())
    }

    /// Waits for a future. If the proof expires before the future is ready, passes the expiry to `report`.
    async fn wait_for<T>(&mut self, future: impl Future<Output = io::Result<T>>) -> io::Result<T> {
        let mut future = pin!(future);
        // While this process runs, the loop below ends a proof as soon as the proof expires. If the time of a proof has
        // passed before the loop, this process was paused, which says nothing about the other process.
        let was_paused = self.proof.valid_for(self.clock.mono()) == Some(Span::ZERO);
        if was_paused && let Ok(output) = tokio::time::timeout(FIRST_ANSWER_TIMEOUT, &mut future).await {
            return output;
        }
        loop {
            let remaining = self.proof.valid_for(self.clock.mono());
            let expiry = async {
                match remaining {
                    Some(remaining) => {
                        tokio::time::sleep(Duration::from_nanos(remaining.nanos().unsigned_abs())).await;
                    }
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                // An answer that has arrived may renew the proof, so the answer is handled before the expiry.
                biased;
                output = &mut future => return output,
                () = expiry => {
                    if self.proof.expire(self.clock.mono()) {
                        (self.report)(Err(NotProven::Expired));
                    }
                }
            }
        }
    }
}
