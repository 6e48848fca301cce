//! Limits of the connections of a listener.

use std::time::Duration;

/// Limits and timeouts of a listener.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ListenerLimits {
    /// Maximum number of open connections.
    pub max_connections: usize,
    /// Largest message of an admitted connection, all frames together. Bytes.
    pub max_message_bytes: usize,
    /// Memory for the unfinished messages of all admitted connections. A single message of the largest length and at
    /// most 1,024 frames is always possible. Bytes.
    pub max_unfinished_bytes: u64,
    /// Time limit for the hello that admits a connection, after the ZMTP handshake.
    pub hello_timeout: Duration,
    /// Maximum number of messages that wait to be written to one connection.
    pub max_queued_messages: usize,
    /// Maximum number of bytes that wait to be written to one connection. A single message is always accepted.
    pub max_queued_bytes: usize,
    /// Interval at which a silent peer is sent a PING.
    pub heartbeat_interval: Duration,
    /// Time after which a connection is closed if its peer sends nothing at all, not even the rest of a frame.
    pub heartbeat_timeout: Duration,
}

/// Time limit for the ZMTP handshake.
pub(super) const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(2);

/// Largest command of the ZMTP handshake. CURVE's largest command is below 1 KiB without metadata. Bytes.
pub(super) const MAX_HANDSHAKE_BYTES: usize = 8 * 1024;

/// Largest unfinished input of a connection before it is admitted. Bytes.
pub(super) const MAX_UNADMITTED_BYTES: usize = 64 * 1024;

/// Largest unfinished input of all connections that are not admitted. This budget is separate from the budget of
/// admitted connections, so that unknown peers cannot exhaust the memory of admitted connections. Bytes.
pub(super) const MAX_ALL_UNADMITTED_BYTES: u64 = 16 * 1024 * 1024;

/// Memory of a frame in addition to its bytes.
pub(super) const FRAME_OVERHEAD_BYTES: usize = 64;

impl ListenerLimits {
    /// Returns the maximum number of open connections of one remote address: half of all. The loopback address is
    /// exempt.
    pub(super) const fn max_per_address(&self) -> usize {
        // One address alone cannot take all places.
        at_least_one(self.max_connections / 2)
    }

    /// Returns the maximum number of open connections that are not admitted: half of all.
    pub(super) const fn max_unadmitted(&self) -> usize {
        // Half of the places stay for connections with a session.
        at_least_one(self.max_connections / 2)
    }

    /// Returns the maximum number of open connections of one remote address that are not admitted: a quarter of all.
    pub(super) const fn max_unadmitted_per_address(&self) -> usize {
        at_least_one(self.max_connections / 4)
    }

    /// Returns the budget of unfinished messages. A single message of the largest length and at most 1,024 frames always
    /// fits.
    pub(super) fn unfinished_budget(&self) -> u64 {
        // The added bytes cover `FRAME_OVERHEAD_BYTES` of 1,024 frames.
        let largest = self.max_message_bytes as u64 + MAX_UNADMITTED_BYTES as u64;
        self.max_unfinished_bytes.max(largest)
    }
}

const fn at_least_one(count: usize) -> usize {
    if count == 0 { 1 } else { count }
}
