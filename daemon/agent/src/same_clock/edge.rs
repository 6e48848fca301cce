//! The edge's end: the socket that a session names, and the questions over its connections.

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

use super::messages::Answer;
use super::proof::{NotProven, Outcome, OwnClock, Proof};

/// Largest number of processes that may connect while a session is opened. Usually it is one; others do not belong to
/// PEERNet.
const MAX_PEERS: usize = 16;
/// Time after which a process that has not answered the first question is ignored: it does not serve the session, or
/// is stopped. A question that is late because this process was paused has as much time.
const FIRST_ANSWER_TIMEOUT: Duration = Duration::from_millis(500);

/// The socket that a session names while it is opened.
#[derive(Debug)]
pub(crate) struct ClockSocket {
    name: ClockSocketName,
    listener: UnixListener,
}

impl ClockSocket {
    /// Listens at a random name. Returns `None` if this process cannot prove anything about its clock.
    pub(crate) fn listen(clock: &dyn Clock) -> Option<Self> {
        if !clock.shows_kernel_time() {
            return None;
        }
        let mut digits = [0; ClockSocketName::BYTES];
        digits.copy_from_slice(&Key::random_bytes()[..ClockSocketName::BYTES]);
        let name = ClockSocketName::new(digits);
        match bind(name) {
            Ok(listener) => Some(Self { name, listener }),
            Err(error) => {
                tracing::warn!(
                    "cannot listen on an abstract Unix socket, so that delays to clouds on this machine are measured: {error}"
                );
                None
            }
        }
    }

    pub(crate) const fn name(&self) -> ClockSocketName {
        self.name
    }

    /// Closes the socket and returns the connections. A cloud connects before it accepts the session.
    pub(crate) fn connected(self, session: SessionId) -> ClockPeers {
        let mut streams = Vec::new();
        // Non-blocking: if no connection waits, `accept` returns an error.
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

/// Connections of the processes that connected to a session's socket; clones share them.
#[derive(Clone, Debug, Default)]
pub(crate) struct ClockPeers {
    /// Id of the session; `None` if there can be no connection.
    session: Option<SessionId>,
    streams: Arc<Mutex<Vec<StdStream>>>,
}

/// Asks the connected processes for proofs as long as the future is polled, and passes each change to `tell`.
pub(crate) async fn prove(
    peers: &ClockPeers,
    clock: &SharedClock,
    tell: impl Fn(Result<(), NotProven>),
) -> Infallible {
    let streams = std::mem::take(&mut *peers.streams.lock().unwrap_or_else(PoisonError::into_inner));
    let mut last = NotProven::NotConnected;
    for stream in streams {
        let Some(session) = peers.session else { break };
        last = match time_namespace() {
            Ok(namespace) => {
                let proof = Proof::new(*session.as_bytes(), namespace);
                let Err(why) = Proving { proof, clock, tell: &tell }.run(stream).await;
                why
            }
            Err(error) => error.into(),
        };
    }
    tell(Err(last));
    std::future::pending().await
}

/// Asks one process.
struct Proving<'a, F> {
    proof: Proof,
    clock: &'a SharedClock,
    tell: &'a F,
}

impl<F: Fn(Result<(), NotProven>)> Proving<'_, F> {
    /// Asks repeatedly until the other end closes, or turns out to be a foreign process.
    async fn run(mut self, stream: StdStream) -> Result<Infallible, NotProven> {
        stream.set_nonblocking(true)?;
        let mut stream = UnixStream::from_std(stream)?;
        let first = tokio::time::timeout(FIRST_ANSWER_TIMEOUT, self.ask(&mut stream)).await;
        first.map_err(|_| NotProven::Foreign)??;
        loop {
            let pause = self.proof.pause();
            let rest = async {
                tokio::time::sleep(pause).await;
                Ok(())
            };
            self.meanwhile(rest).await?;
            self.ask(&mut stream).await?;
        }
    }

    /// Asks one question and handles its answer, however long it takes.
    async fn ask(&mut self, stream: &mut UnixStream) -> Result<(), NotProven> {
        // A new nonce for each question, so that an old answer is not taken for a new one.
        let nonce = Uuid::new_v4().into_bytes();
        let question = self.proof.ask(nonce, self.clock.raw()).to_bytes();
        let answer = self.meanwhile(async {
            let mut answer = [0; Answer::BYTES];
            stream.write_all(&question).await?;
            stream.read_exact(&mut answer).await?;
            Ok(answer)
        });
        let answer = Answer::from_bytes(&answer.await?);
        let raw = self.clock.raw();
        let own =
            OwnClock { raw, mono: self.clock.mono(), shows_kernel_time: self.clock.shows_kernel_time() };
        match self.proof.answered(answer, own) {
            Outcome::Proven => (self.tell)(Ok(())),
            Outcome::Refuted(why) => (self.tell)(Err(why)),
            Outcome::Slow => {}
            Outcome::Foreign => return Err(NotProven::Foreign),
        }
        Ok(())
    }

    /// Waits for a future. If the proof expires before it is ready, passes that to `tell`.
    async fn meanwhile<T>(&mut self, waiting: impl Future<Output = io::Result<T>>) -> io::Result<T> {
        let mut waiting = pin!(waiting);
        // The proof was not renewed in time because this process was paused, which says nothing about the other
        // process.
        let was_paused = self.proof.holds_for(self.clock.mono()) == Some(Span::ZERO);
        if was_paused && let Ok(done) = tokio::time::timeout(FIRST_ANSWER_TIMEOUT, &mut waiting).await {
            return done;
        }
        loop {
            let left = self.proof.holds_for(self.clock.mono());
            let expiry = async {
                match left {
                    Some(left) => tokio::time::sleep(Duration::from_nanos(left.nanos().unsigned_abs())).await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                biased;
                done = &mut waiting => return done,
                () = expiry => {
                    if self.proof.expire(self.clock.mono()) {
                        (self.tell)(Err(NotProven::Expired));
                    }
                }
            }
        }
    }
}
