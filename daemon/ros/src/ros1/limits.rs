//! Limits of a node.

use std::time::Duration;

/// Limits of a queue of messages. An empty queue accepts every message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct QueueLimits {
    /// Maximum number of waiting messages.
    pub messages: usize,
    /// Maximum number of bytes of waiting messages.
    pub bytes: usize,
}

impl Default for QueueLimits {
    fn default() -> Self {
        Self { messages: 256, bytes: 64 * 1024 * 1024 }
    }
}

impl QueueLimits {
    /// Returns whether a message fits into a queue with these contents.
    pub(super) fn accepts(&self, waiting: usize, waiting_bytes: usize, length: usize) -> bool {
        waiting == 0 || (waiting < self.messages && waiting_bytes.saturating_add(length) <= self.bytes)
    }
}

/// Maximum number of TCPROS connections that others open to a node. Further connections are closed at once.
pub(super) const MAX_INCOMING_CONNECTIONS: usize = 256;

/// Maximum number of publishers of one topic that a subscriber connects to. Further publishers are ignored with a
/// warning.
pub(super) const MAX_PUBLISHERS: usize = 256;

/// Time limit for connecting and exchanging headers.
pub(super) const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(5);

/// Time limit within which a publisher that ends must have written its queues.
pub(super) const DRAIN_TIMEOUT: Duration = Duration::from_secs(1);

/// Time after which the kernel ends a TCP connection whose sent bytes are not acknowledged, because the other end is
/// unreachable or does not read. The kernel's default is a quarter of an hour.
pub(super) const USER_TIMEOUT: Duration = Duration::from_secs(30);

/// Silence of a TCP connection after which the kernel sends [`KEEPALIVE_PROBES`] keepalive probes, one every
/// [`KEEPALIVE_INTERVAL`], and ends the connection if none is answered.
pub(super) const KEEPALIVE_IDLE: Duration = Duration::from_secs(10);

/// Interval between keepalive probes.
pub(super) const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(5);

/// Number of unanswered keepalive probes that end a connection.
pub(super) const KEEPALIVE_PROBES: u32 = 4;
