//! What connections of a listener may cost.

use std::time::Duration;

/// Limits and time limits of a listener.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ListenerLimits {
    /// Connections that may be open at once.
    pub max_connections: usize,
    /// Largest message accepted from an admitted connection, all frames together. Bytes.
    pub max_message_bytes: usize,
    /// Memory that the unfinished messages of all admitted connections may take together. Bytes; at least one
    /// largest message is always possible.
    pub max_unfinished_bytes: u64,
    /// How long a connection may take to send the hello that admits it, after the ZMTP handshake.
    pub hello_timeout: Duration,
    /// Messages that may wait to be written to one connection.
    pub max_queued_messages: usize,
    /// Bytes that may wait to be written to one connection; a single message is always taken.
    pub max_queued_bytes: usize,
    /// How often a silent peer is sent a PING.
    pub heartbeat_interval: Duration,
    /// How long a peer may send nothing at all, not even the rest of a frame, before its connection is closed.
    pub heartbeat_timeout: Duration,
}

/// How long a connection may take for the ZMTP handshake.
pub(super) const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(2);

/// Most bytes of a command of the ZMTP handshake; CURVE's largest is below 1 KiB without metadata.
pub(super) const MAX_HANDSHAKE_BYTES: usize = 8 * 1024;

/// Bytes of unfinished input that a connection may hold before it is admitted.
pub(super) const MAX_UNADMITTED_BYTES: usize = 64 * 1024;

/// Bytes of unfinished input that all connections may hold together before they are admitted. Apart from the
/// budget of admitted ones, so that a stranger cannot take it from them.
pub(super) const MAX_ALL_UNADMITTED_BYTES: u64 = 16 * 1024 * 1024;

/// What a frame costs beside its bytes.
pub(super) const FRAME_OVERHEAD_BYTES: usize = 64;

impl ListenerLimits {
    /// Connections of one remote address that may be open at once: half of all. This machine's own addresses are
    /// exempt.
    pub(super) const fn max_per_address(&self) -> usize {
        at_least_one(self.max_connections / 2)
    }

    /// Connections that may be open at once without being admitted: half of all.
    pub(super) const fn max_unadmitted(&self) -> usize {
        at_least_one(self.max_connections / 2)
    }

    /// The same of one remote address: a quarter of all.
    pub(super) const fn max_unadmitted_per_address(&self) -> usize {
        at_least_one(self.max_connections / 4)
    }

    /// The budget of unfinished messages; one largest message alone always fits.
    pub(super) fn unfinished_budget(&self) -> u64 {
        let largest = self.max_message_bytes as u64 + MAX_UNADMITTED_BYTES as u64;
        self.max_unfinished_bytes.max(largest)
    }
}

const fn at_least_one(count: usize) -> usize {
    if count == 0 { 1 } else { count }
}
