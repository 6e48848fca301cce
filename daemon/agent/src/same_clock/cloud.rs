//! The cloud's end: connects to the socket of an edge and answers the edge's queries.

use std::io;
use std::os::unix::net::UnixStream as StdStream;

use peernet_clock::{SharedClock, time_namespace};
use peernet_networks::{SessionHello, SessionId};
use socket2::{Domain, SockAddr, Socket, Type};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::UnixStream;

use super::messages::{ClockAnswer, ClockQuery};

/// A connection to the edge of a session, over which the edge queries the readings of this process's clocks.
#[derive(Debug)]
pub(crate) struct ClockResponder {
    stream: StdStream,
    session: SessionId,
    time_namespace: u64,
    clock: SharedClock,
}

impl ClockResponder {
    /// Connects to the socket in an edge's hello, without waiting. Returns `None` if the hello names no socket, if the
    /// two clocks cannot be the same clock, or if the socket cannot be reached because the edge is on another machine
    /// or in another network namespace.
    pub(crate) fn connect(hello: &SessionHello, session: SessionId, clock: &SharedClock) -> Option<Self> {
        let name = hello.clock_socket?;
        if !hello.clock.may_share_clock_with(clock.identity()) || !clock.shows_kernel_time() {
            return None;
        }
        let connection = time_namespace().and_then(|namespace| Ok((namespace, connect(&name.to_string())?)));
        match connection {
            Ok((time_namespace, stream)) => {
                Some(Self { stream, session, time_namespace, clock: SharedClock::clone(clock) })
            }
            Err(error) => {
                tracing::debug!(edge = %hello.name, %error, "cannot connect to the edge's clock socket");
                None
            }
        }
    }

    /// Answers until the edge closes the connection or sends an invalid query.
    pub(crate) async fn answer(self) {
        if let Err(error) = self.answer_all().await {
            // The edge estimates the delays from then on, and reports the lost proof.
            tracing::debug!(session = %self.session, %error, "stopped answering queries about the clock");
        }
    }

    async fn answer_all(&self) -> io::Result<()> {
        let mut stream = UnixStream::from_std(self.stream.try_clone()?)?;
        loop {
            let mut query = [0; ClockQuery::BYTES];
            stream.read_exact(&mut query).await?;
            let Some(ClockQuery { nonce }) = ClockQuery::from_bytes(&query) else {
                return Err(io::Error::new(io::ErrorKind::InvalidData, "the edge sent an invalid query"));
            };
            let answer = ClockAnswer {
                nonce,
                session: *self.session.as_bytes(),
                time_namespace: self.time_namespace,
                shows_kernel_time: self.clock.shows_kernel_time(),
                raw: self.clock.raw(),
            };
            stream.write_all(&answer.to_bytes()).await?;
        }
    }
}

/// Connects to an abstract socket of this network namespace without blocking.
// Waiting for an edge that no longer accepts connections would delay all other sessions.
fn connect(name: &str) -> io::Result<StdStream> {
    let socket = Socket::new(Domain::UNIX, Type::STREAM, None)?;
    socket.set_nonblocking(true)?;
    socket.connect(&SockAddr::unix(format!("\0{name}"))?)?;
    Ok(socket.into())
}
