//! The cloud's end: connects to the socket of an edge and answers its questions.

use std::io;
use std::os::unix::net::UnixStream as StdStream;

use peernet_clock::{SharedClock, time_namespace};
use peernet_networks::{SessionHello, SessionId};
use socket2::{Domain, SockAddr, Socket, Type};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::UnixStream;

use super::messages::{Answer, Question};

/// A connection to the edge of a session, over which it asks for the readings of this process's clocks.
#[derive(Debug)]
pub(crate) struct ClockWitness {
    stream: StdStream,
    session: SessionId,
    time_namespace: u64,
    clock: SharedClock,
}

impl ClockWitness {
    /// Connects to the socket that an edge names. Returns `None` if it names none, if the two clocks cannot be one,
    /// or if the socket cannot be reached, because the edge is on another machine or in another network namespace.
    /// Never waits.
    pub(crate) fn connect(hello: &SessionHello, session: SessionId, clock: &SharedClock) -> Option<Self> {
        let name = hello.clock_socket?;
        if !hello.clock.may_share_clock_with(clock.identity()) || !clock.shows_kernel_time() {
            return None;
        }
        let connected = time_namespace().and_then(|namespace| Ok((namespace, connect(&name.to_string())?)));
        match connected {
            Ok((time_namespace, stream)) => {
                Some(Self { stream, session, time_namespace, clock: SharedClock::clone(clock) })
            }
            Err(error) => {
                tracing::debug!(edge = %hello.name, %error, "cannot connect to the edge's clock socket");
                None
            }
        }
    }

    /// Answers until the edge closes the connection or sends something that is not a question.
    pub(crate) async fn answer(self) {
        if let Err(error) = self.answer_all().await {
            // The edge measures the delays from now on, and reports it.
            tracing::debug!(session = %self.session, %error, "answers no more questions about the clock");
        }
    }

    async fn answer_all(&self) -> io::Result<()> {
        let mut stream = UnixStream::from_std(self.stream.try_clone()?)?;
        loop {
            let mut question = [0; Question::BYTES];
            stream.read_exact(&mut question).await?;
            let Some(Question { nonce }) = Question::from_bytes(&question) else {
                return Err(io::Error::new(io::ErrorKind::InvalidData, "what the edge sent is no question"));
            };
            let answer = Answer {
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

/// Connects to an abstract socket of this network namespace, at once or not at all: waiting for an edge that no
/// longer accepts would delay all other sessions.
fn connect(name: &str) -> io::Result<StdStream> {
    let socket = Socket::new(Domain::UNIX, Type::STREAM, None)?;
    socket.set_nonblocking(true)?;
    socket.connect(&SockAddr::unix(format!("\0{name}"))?)?;
    Ok(socket.into())
}
