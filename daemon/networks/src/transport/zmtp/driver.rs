//! The task of one connection: reads, watches deadlines, and writes what senders could not write.

use std::collections::VecDeque;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use bytes::BufMut;
use omq_proto::Message;
use omq_proto::proto::{Command, Event};
use tokio::io::{AsyncRead, AsyncReadExt, ReadBuf};
use tokio::net::tcp::OwnedReadHalf;
use tokio::sync::mpsc;
use tokio::time::{Instant, Sleep, sleep_until};

use super::connection::{Phase, ZmtpConnection};
use super::deadlines::{Deadlines, DueAction};
use super::framer::{Allowance, Framer, Piece, Stage, Violation};
use super::limits::ListenerLimits;
use super::listener::Delivery;
use super::rejections::Rejection;
use crate::transport::memory::{MemoryBudget, Reservation};
use crate::transport::{Frames, ListenerEvent, Peer};

/// Maximum number of bytes of one read while no long frame is expected.
// These bytes are read into an array on the call stack and copied into frames, so that an idle connection has no
// buffer.
const READ_BYTES: usize = 16 * 1024;

/// Reading pauses while more bytes of PONGs wait to be written. This stops a peer that sends PINGs and reads nothing.
const MAX_QUEUED_PONG_BYTES: usize = 16 * 1024;

/// Time limit for a peer to close its end after everything was sent to the peer.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(200);

/// Reason for the end of a connection.
#[derive(Debug)]
pub(super) enum ConnectionEnd {
    /// The peer closed the connection, or the connection broke.
    Peer(String),
    /// The peer exceeded a limit or violated the protocol.
    Rejected(Rejection, String),
    /// The listener closes.
    Closed,
}

/// State of the task of a connection.
pub(super) struct Driver {
    pub(super) connection: Arc<ZmtpConnection>,
    input: Input,
    deadlines: Deadlines,
    deliveries: mpsc::Sender<Delivery>,
    /// Complete messages that were not handed to the listener yet.
    messages: VecDeque<(Message, Reservation)>,
    /// `true` if a message was handed to the listener.
    pub(super) has_delivered: bool,
    /// `true` if the handshake succeeded.
    pub(super) is_ready: bool,
    /// `true` if bytes may wait to be written.
    has_output: bool,
}

/// Bytes from the peer, split into pieces that the library decodes.
struct Input {
    reader: OwnedReadHalf,
    framer: Framer,
    allowance: Allowance,
    pieces: Vec<Piece>,
}

/// The budgets that all connections of a listener share.
#[derive(Clone, Debug)]
pub(super) struct Budgets {
    /// Memory of unfinished messages of connections that are not admitted.
    pub(super) unadmitted: Arc<MemoryBudget>,
    /// Memory of unfinished messages of admitted connections.
    pub(super) admitted: Arc<MemoryBudget>,
    /// Memory of queued bytes that the kernel has not accepted.
    pub(super) output: Arc<MemoryBudget>,
}

impl Driver {
    pub(super) fn new(
        connection: Arc<ZmtpConnection>,
        reader: OwnedReadHalf,
        limits: &ListenerLimits,
        budgets: &Budgets,
        deliveries: mpsc::Sender<Delivery>,
    ) -> Self {
        let allowance = Allowance {
            stage: Stage::Handshake,
            max_message_bytes: limits.max_message_bytes,
            unadmitted: Arc::clone(&budgets.unadmitted),
            admitted: Arc::clone(&budgets.admitted),
        };
        Self {
            connection,
            input: Input { reader, framer: Framer::new(&allowance), allowance, pieces: Vec::new() },
            deadlines: Deadlines::new(limits, Instant::now()),
            deliveries,
            messages: VecDeque::new(),
            has_delivered: false,
            is_ready: false,
            // A new codec has queued its greeting already.
            has_output: true,
        }
    }

    /// Runs until the connection ends. All messages that arrived before the end have then been handed to the
    /// listener.
    pub(super) async fn run(&mut self) -> ConnectionEnd {
        // The timer expires at once. Its first event sets the first deadline.
        let mut timer = std::pin::pin!(sleep_until(Instant::now()));
        loop {
            if let Some(end) = self.apply_phase(timer.as_mut()) {
                return end;
            }
            if self.has_output
                && let Some(end) = self.write()
            {
                return end;
            }
            let connection = Arc::clone(&self.connection);
            let must_write_first = self.must_write_first();
            let event = tokio::select! {
                // Reading comes first: a peer that sends without pause must not look silent to the deadlines.
                biased;
                read = self.input.read(&connection), if !must_write_first => TaskEvent::Read(read),
                () = connection.wake.notified() => TaskEvent::Notified,
                result = connection.writer.writable(), if self.has_output => TaskEvent::Writable(result.is_ok()),
                () = timer.as_mut() => TaskEvent::Timer,
            };
            match event {
                TaskEvent::Read(ReadOutcome::Bytes) => {
                    // Any bytes show that the peer is alive, not only answers to a PING.
                    self.deadlines.has_received = true;
                    if let Err((reason, text)) = self.decode() {
                        return ConnectionEnd::Rejected(reason, text);
                    }
                    if !self.deliver().await {
                        return ConnectionEnd::Closed;
                    }
                    // While a peer sends without pause, the timer is never polled.
                    if timer.deadline() <= Instant::now()
                        && let Some(end) = self.check_deadlines(timer.as_mut())
                    {
                        return end;
                    }
                }
                TaskEvent::Read(ReadOutcome::End(reason)) => return ConnectionEnd::Peer(reason),
                TaskEvent::Read(ReadOutcome::Violation((reason, text))) => {
                    // Messages that were complete before the violation are still delivered.
                    if self.decode().is_ok() {
                        self.deliver().await;
                    }
                    return ConnectionEnd::Rejected(reason, text);
                }
                TaskEvent::Notified => self.has_output = true,
                TaskEvent::Writable(true) => {}
                TaskEvent::Writable(false) => return ConnectionEnd::Peer("the connection was lost".into()),
                TaskEvent::Timer => {
                    if let Some(end) = self.check_deadlines(timer.as_mut()) {
                        return end;
                    }
                }
            }
        }
    }

    /// Returns whether queued PONGs must be written before more is read.
    fn must_write_first(&self) -> bool {
        self.has_output && self.connection.codec().zmtp.pending_pong_size() > MAX_QUEUED_PONG_BYTES
    }

    /// Applies the phase of the connection if another thread has changed it. Returns the end that the phase demands, if
    /// any.
    fn apply_phase(&mut self, timer: Pin<&mut Sleep>) -> Option<ConnectionEnd> {
        let phase = self.connection.phase();
        if phase == self.deadlines.phase() {
            return None;
        }
        let now = Instant::now();
        self.deadlines.enter(phase, now);
        timer.reset(self.deadlines.next_check(now));
        match phase {
            Phase::Closing => Some(ConnectionEnd::Closed),
            Phase::Replaced => Some(ConnectionEnd::Rejected(
                Rejection::Replaced,
                "a newer connection replaced this connection, because the maximum number of connections was open".into(),
            )),
            _ => None,
        }
    }

    /// Writes queued bytes. Returns the end of the connection if it is broken.
    fn write(&mut self) -> Option<ConnectionEnd> {
        let result = self.connection.write(&mut self.connection.codec());
        match result {
            Ok(is_queue_empty) => {
                self.has_output = !is_queue_empty;
                None
            }
            Err(error) => Some(ConnectionEnd::Peer(error.to_string())),
        }
    }

    /// Lets the library decode the pieces, and collects complete messages.
    fn decode(&mut self) -> Result<(), Violation> {
        let connection = Arc::clone(&self.connection);
        let mut codec = connection.codec();
        for Piece { bytes, message_memory } in self.input.pieces.drain(..) {
            codec.zmtp.handle_input(bytes).map_err(|error| classify_violation(&error, self.is_ready))?;
            while let Some(event) = codec.zmtp.poll_event() {
                if let Event::HandshakeSucceeded { peer_properties, .. } = event {
                    // A connection could otherwise claim the routing id of another connection.
                    if peer_properties.identity.as_ref().is_some_and(|identity| !identity.is_empty()) {
                        let text = "the peer chose its own routing id, which is not allowed".into();
                        return Err((Rejection::Handshake, text));
                    }
                    self.is_ready = true;
                    self.connection.advance(Phase::Unadmitted);
                }
            }
            // The framer adds the memory of a message to the piece that ends the message.
            if let Some(reserved) = message_memory
                && let Some(message) = codec.zmtp.poll_message()
            {
                self.messages.push_back((message, reserved));
            }
        }
        self.has_output |= codec.zmtp.has_pending_transmit();
        Ok(())
    }

    /// Hands complete messages to the listener, and waits while the listener's queue is full. Returns `false` if the
    /// listener is gone.
    async fn deliver(&mut self) -> bool {
        while let Some((message, reserved)) = self.messages.pop_front() {
            let frames: Frames = message.iter().collect();
            let peer = Peer { connection: self.connection.id, address: Some(self.connection.address) };
            let delivery =
                Delivery { event: ListenerEvent::Message(peer, frames), _reserved: Some(reserved) };
            if self.deliveries.send(delivery).await.is_err() {
                return false;
            }
            self.has_delivered = true;
        }
        true
    }

    /// Sends a PING or ends the connection if that is due. Sets the timer to the next check.
    fn check_deadlines(&mut self, timer: Pin<&mut Sleep>) -> Option<ConnectionEnd> {
        let now = Instant::now();
        timer.reset(self.deadlines.next_check(now));
        match self.deadlines.due_action(now) {
            DueAction::Nothing => None,
            DueAction::Ping => {
                self.ping();
                None
            }
            DueAction::End(reason, text) => Some(ConnectionEnd::Rejected(reason, text)),
        }
    }

    /// Queues a PING, unless it would be useless.
    fn ping(&mut self) {
        let mut codec = self.connection.codec();
        // Peers of ZMTP 3.0 do not know heartbeats. While bytes are queued, a PING would only wait behind them.
        if codec.zmtp.peer_minor() == 0 || codec.zmtp.has_pending_transmit() {
            return;
        }
        // With a TTL of 0 the peer's own settings determine when the peer gives up the connection.
        let ping = Command::Ping { ttl_deciseconds: 0, context: bytes::Bytes::new() };
        if let Err(error) = codec.zmtp.send_command(&ping) {
            tracing::debug!(%error, "cannot send a heartbeat");
        }
        drop(codec);
        self.has_output = true;
    }

    /// Sends queued bytes, until `deadline` at most. Then waits briefly for the peer to close the connection.
    pub(super) async fn finish(&mut self, deadline: Instant) {
        let connection = Arc::clone(&self.connection);
        let flush = async {
            loop {
                match connection.write(&mut connection.codec()) {
                    Ok(false) => {}
                    Ok(true) | Err(_) => return,
                }
                if connection.writer.writable().await.is_err() {
                    return;
                }
            }
        };
        // Bytes that are not sent before the deadline are lost with the connection.
        let _unsent = tokio::time::timeout_at(deadline, flush).await;
        // Closing a socket with unread bytes would reset the connection, and the peer would lose what it has not read.
        shut_down_writing(&self.input.reader);
        let mut scratch = vec![0; READ_BYTES];
        let drain = async { while matches!(self.input.reader.read(&mut scratch).await, Ok(1..)) {} };
        let _still_open = tokio::time::timeout_at(deadline.min(Instant::now() + CLOSE_TIMEOUT), drain).await;
    }
}

fn shut_down_writing(reader: &OwnedReadHalf) {
    // Fails if the peer has already closed the connection.
    let _closed = socket2::SockRef::from(reader.as_ref()).shutdown(std::net::Shutdown::Write);
}

fn classify_violation(error: &omq_proto::Error, is_ready: bool) -> Violation {
    let reason = match error {
        _ if !is_ready => Rejection::Handshake,
        omq_proto::Error::MessageTooLarge { .. } => Rejection::TooLarge,
        _ => Rejection::Protocol,
    };
    (reason, error.to_string())
}

/// Event that the task of a connection waited for.
enum TaskEvent {
    Read(ReadOutcome),
    Notified,
    Writable(bool),
    Timer,
}

/// Result of one read.
enum ReadOutcome {
    Bytes,
    End(String),
    Violation(Violation),
}

impl Input {
    /// Reads once, into the buffer of a long frame or into pieces. Cancel safe: dropping the future loses nothing.
    async fn read(&mut self, connection: &ZmtpConnection) -> ReadOutcome {
        let Self { reader, framer, allowance, pieces } = self;
        std::future::poll_fn(|cx| {
            // The phase is read at each poll: the peer's first bytes after its admission may arrive before the
            // admission wakes this task.
            allowance.stage = stage_of_phase(connection.phase());
            poll_read(cx, reader, framer, allowance, pieces)
        })
        .await
    }
}

const fn stage_of_phase(phase: Phase) -> Stage {
    match phase {
        Phase::Handshake => Stage::Handshake,
        Phase::Unadmitted | Phase::Greeted => Stage::Unadmitted,
        // In the last two phases the task reads at most once more. Narrower limits would reject an admitted connection
        // that closes.
        Phase::Admitted | Phase::Closing | Phase::Replaced => Stage::Admitted,
    }
}

fn poll_read(
    cx: &mut Context<'_>,
    reader: &mut OwnedReadHalf,
    framer: &mut Framer,
    allowance: &Allowance,
    pieces: &mut Vec<Piece>,
) -> Poll<ReadOutcome> {
    let (read, result) = match framer.direct_buffer(allowance) {
        Err(violation) => return Poll::Ready(ReadOutcome::Violation(violation)),
        Ok(Some(mut buffer)) => {
            debug_assert!(buffer.has_remaining_mut());
            let read = std::pin::pin!(reader.read_buf(&mut buffer)).poll(cx);
            let read = ready!(read);
            (read, framer.complete_direct_read(allowance, pieces))
        }
        Ok(None) => {
            let mut scratch = [0; READ_BYTES];
            let mut buffer = ReadBuf::new(&mut scratch);
            let read = ready!(Pin::new(reader).poll_read(cx, &mut buffer));
            (read.map(|()| buffer.filled().len()), framer.receive(buffer.filled(), allowance, pieces))
        }
    };
    Poll::Ready(match (read, result) {
        (Ok(0), _) => ReadOutcome::End("the peer closed the connection".into()),
        (Err(error), _) => ReadOutcome::End(error.to_string()),
        (_, Err(violation)) => ReadOutcome::Violation(violation),
        (Ok(_), Ok(())) => ReadOutcome::Bytes,
    })
}
