//! Upper bounds of a node.

use std::time::Duration;

/// Bound of a queue of messages. A message is always taken into an empty queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct QueueLimits {
    /// Messages that wait at most.
    pub messages: usize,
    /// Bytes of the messages that wait at most.
    pub bytes: usize,
}

impl Default for QueueLimits {
    fn default() -> Self {
        Self { messages: 256, bytes: 64 * 1024 * 1024 }
    }
}

impl QueueLimits {
    /// Returns whether a message fits beside what waits.
    pub(super) fn admit(&self, waiting: usize, waiting_bytes: usize, length: usize) -> bool {
        waiting == 0 || (waiting < self.messages && waiting_bytes.saturating_add(length) <= self.bytes)
    }
}

/// TCPROS connections that others open to a node at a time. More are closed at once.
pub(super) const MAX_INCOMING_CONNECTIONS: usize = 256;

/// Publishers of one topic that a subscriber connects to. More are left out, with a warning.
pub(super) const MAX_PUBLISHERS: usize = 256;

/// Longest duration of connecting and exchanging headers.
pub(super) const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(5);

/// Longest duration in which a publisher that ends writes the messages in its queues.
pub(super) const DRAIN_TIMEOUT: Duration = Duration::from_secs(1);

/// Longest duration for which sent bytes may wait for the other end, because it is unreachable or reads nothing, before the
/// kernel ends a TCP connection. Without it that takes a quarter of an hour.
pub(super) const USER_TIMEOUT: Duration = Duration::from_secs(30);

/// Silence of a TCP connection after which the kernel sends [`KEEPALIVE_PROBES`] keepalive probes, one every
/// [`KEEPALIVE_INTERVAL`], and ends the connection if none is answered.
pub(super) const KEEPALIVE_IDLE: Duration = Duration::from_secs(10);

/// Time between keepalive probes.
pub(super) const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(5);

/// Keepalive probes without an answer that end a connection.
pub(super) const KEEPALIVE_PROBES: u32 = 4;
