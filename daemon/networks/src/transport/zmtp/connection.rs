//! The part of a connection that many threads share: sending, and the connection's phase.

use std::collections::VecDeque;
use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use omq_proto::proto::connection::{Connection, ConnectionConfig, Role};
use omq_proto::{Message, Payload, SocketType};
use tokio::net::tcp::OwnedWriteHalf;
use tokio::sync::{Notify, OwnedSemaphorePermit};

use super::limits::ListenerLimits;
use crate::statistics::ConnectionAddresses;
use crate::transport::memory::{MemoryBudget, Reservation};
use crate::transport::{AddressGroup, ConnectionId, Frames, SendFailure};

/// Maximum number of slices that one write gathers.
const MAX_SLICES: usize = 64;

/// Phase of a connection. Only [`advance`](ZmtpConnection::advance) changes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub(super) enum Phase {
    /// The ZMTP handshake has not ended.
    Handshake,
    /// The connection has no session and has not asked for one.
    Unadmitted,
    /// The connection has asked for a session and waits for the decision.
    Greeted,
    /// The connection has a session.
    Admitted,
    /// The listener closes; queued messages are still sent.
    Closing,
    /// A newer connection replaces this one.
    Replaced,
}

const PHASES: [Phase; 6] =
    [Phase::Handshake, Phase::Unadmitted, Phase::Greeted, Phase::Admitted, Phase::Closing, Phase::Replaced];

/// A connection, with the interface that senders use.
pub(super) struct ZmtpConnection {
    pub(super) id: ConnectionId,
    pub(super) address: SocketAddr,
    pub(super) group: AddressGroup,
    pub(super) writer: OwnedWriteHalf,
    codec: Mutex<Codec>,
    phase: AtomicU8,
    /// Wakes the connection's task for a new phase, or for output that the kernel did not accept.
    pub(super) wake: Notify,
    max_queued_messages: usize,
    max_queued_bytes: usize,
    /// Permit to be open. It is dropped after the socket, so that there are never more sockets than permits.
    _permit: OwnedSemaphorePermit,
}

/// The state machine of the library ([`omq_proto`]), which also queues the bytes to send, and counts of these bytes.
#[derive(Debug)]
pub(super) struct Codec {
    pub(super) zmtp: Connection,
    /// Offset of the end of each queued message in the stream of all bytes ever queued.
    message_ends: VecDeque<u64>,
    /// Number of bytes that the kernel has accepted.
    written_bytes: u64,
    /// Memory of the queued bytes.
    reserved: Reservation,
    budget: Arc<MemoryBudget>,
}

impl fmt::Debug for ZmtpConnection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ZmtpConnection").field("id", &self.id).field("address", &self.address).finish()
    }
}

impl ZmtpConnection {
    pub(super) fn new(
        id: ConnectionId,
        address: SocketAddr,
        writer: OwnedWriteHalf,
        permit: OwnedSemaphorePermit,
        limits: &ListenerLimits,
        identity: &'static str,
        output: &Arc<MemoryBudget>,
    ) -> Self {
        let config = ConnectionConfig::new(Role::Server, SocketType::Router)
            .identity(Bytes::from_static(identity.as_bytes()))
            .max_message_size(limits.max_message_bytes);
        let codec = Codec {
            zmtp: Connection::new(config),
            message_ends: VecDeque::new(),
            written_bytes: 0,
            reserved: Reservation::empty(output),
            budget: Arc::clone(output),
        };
        Self {
            id,
            address,
            group: AddressGroup::from_address(address),
            writer,
            codec: Mutex::new(codec),
            phase: AtomicU8::new(Phase::Handshake as u8),
            wake: Notify::new(),
            max_queued_messages: limits.max_queued_messages,
            max_queued_bytes: limits.max_queued_bytes,
            _permit: permit,
        }
    }

    /// Returns the addresses of both ends; `None` if the socket is gone.
    pub(super) fn addresses(&self) -> Option<ConnectionAddresses> {
        let local = self.writer.local_addr().ok()?;
        Some(ConnectionAddresses { local, remote: self.address })
    }

    pub(super) fn codec(&self) -> MutexGuard<'_, Codec> {
        self.codec.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn phase(&self) -> Phase {
        PHASES[usize::from(self.phase.load(Ordering::Acquire))]
    }

    /// Changes the phase if the change is allowed. The last two phases are final, and only an unadmitted connection
    /// becomes greeted.
    pub(super) fn advance(&self, new_phase: Phase) {
        let next_phase = |from: u8| {
            let from = PHASES[usize::from(from)];
            let is_allowed = match new_phase {
                Phase::Handshake => false,
                Phase::Greeted => from == Phase::Unadmitted,
                Phase::Unadmitted | Phase::Admitted => from < Phase::Closing && from != new_phase,
                Phase::Closing | Phase::Replaced => from < Phase::Closing,
            };
            is_allowed.then_some(new_phase as u8)
        };
        // Several threads change the phase: the check and the change must be one step.
        if self.phase.fetch_update(Ordering::AcqRel, Ordering::Acquire, next_phase).is_ok() {
            self.wake.notify_one();
        }
    }

    /// Hands a message to the network. Never waits. The message goes to the kernel if nothing is queued before it, else
    /// to the queue, which the connection's task sends.
    pub(super) fn try_send(&self, frames: Frames) -> Result<(), SendFailure> {
        let gone_failure = |reason: &dyn fmt::Display| SendFailure::Gone(reason.to_string());
        if self.phase() >= Phase::Closing {
            return Err(SendFailure::Gone("the connection is being closed".into()));
        }
        let bytes: usize = frames.iter().map(|frame| frame.len()).sum();
        let message = Message::multipart_payloads(frames.into_iter().map(Payload::from_bytes));
        // The lock is held until the message is queued, so that messages of several threads are not mixed.
        let mut codec = self.codec();
        let queued_bytes = codec.zmtp.pending_transmit_size();
        // An empty queue accepts every message, whatever its size.
        if queued_bytes > 0
            && (queued_bytes.saturating_add(bytes) > self.max_queued_bytes
                || codec.message_ends.len() >= self.max_queued_messages)
        {
            return Err(SendFailure::Full);
        }
        if queued_bytes > 0 {
            // If nothing is queued, `write` reserves memory for the bytes that the kernel does not accept.
            codec.reserve(queued_bytes + bytes).map_err(|_| SendFailure::Full)?;
        }
        codec.zmtp.send_message(&message).map_err(|error| gone_failure(&error))?;
        let end = codec.written_bytes + codec.zmtp.pending_transmit_size() as u64;
        codec.message_ends.push_back(end);
        if queued_bytes > 0 {
            // The connection's task writes the message after the queued messages.
            return Ok(());
        }
        match self.write(&mut codec) {
            Ok(true) => Ok(()),
            Ok(false) => {
                self.wake.notify_one();
                Ok(())
            }
            Err(error) => Err(gone_failure(&error)),
        }
    }

    /// Writes queued bytes until the kernel accepts no more. Returns whether the queue is empty.
    ///
    /// # Errors
    /// If the connection is broken, or the memory for messages that peers have not read is used up.
    pub(super) fn write(&self, codec: &mut Codec) -> io::Result<bool> {
        while codec.zmtp.has_pending_transmit() {
            let result = self.writer.try_write_vectored(&codec.zmtp.transmit_chunks_capped(MAX_SLICES));
            let written = match result {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(written) => written,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    let queued_bytes = codec.zmtp.pending_transmit_size();
                    codec.reserve(queued_bytes)?;
                    return Ok(false);
                }
                Err(error) => return Err(error),
            };
            codec.advance(written);
        }
        // The queue is empty, so the connection no longer needs memory of the budget.
        codec.reserve(0)?;
        Ok(true)
    }
}

impl Codec {
    fn advance(&mut self, written: usize) {
        self.zmtp.advance_transmit(written);
        self.written_bytes += written as u64;
        while self.message_ends.front().is_some_and(|end| *end <= self.written_bytes) {
            self.message_ends.pop_front();
        }
    }

    /// Reserves memory for `queued_bytes` queued bytes.
    fn reserve(&mut self, queued_bytes: usize) -> io::Result<()> {
        let memory_error = |_| {
            io::Error::new(
                io::ErrorKind::OutOfMemory,
                "the memory for messages that peers have not read yet is used up",
            )
        };
        self.reserved.resize(&self.budget, queued_bytes as u64).map_err(memory_error)
    }
}
