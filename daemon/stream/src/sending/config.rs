//! Configuration of batching, spooling and sending.

use peernet_clock::Span;

use super::super::spool::Usage;

/// Compression of batches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compression {
    /// Compress batches while they wait for the link.
    #[default]
    Auto,
    /// Compress every batch.
    Always,
    /// Compress no batch.
    Never,
}

/// Configuration of batching, spooling and sending.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SendingConfig {
    /// Number of nodes at which a batch is closed.
    pub batch_nodes: usize,
    /// Largest body of a batch in bytes; a single larger event forms a batch alone.
    pub batch_bytes: usize,
    /// Age of a batch's first event at which the batch is closed.
    pub batch_age: Span,
    /// Largest window of batches in flight, in units of `batch_bytes`. The aggregator may set a smaller window.
    pub window: u32,
    /// Maximum number of bytes of bodies in the spool.
    pub spool_bytes: u64,
    /// Maximum number of events and bytes that wait in memory because they are not in the spool yet.
    pub memory: Usage,
    /// Capacity in memory that is reserved for events other than iterations, as a number of events. This number must be
    /// well below `memory`, or no iteration ever fits.
    pub reserve_events: u64,
    /// Compression of batches.
    pub compression: Compression,
    /// First pause before a hello is repeated; each further pause is twice as long.
    pub first_pause: Span,
    /// Longest pause before a hello is repeated.
    pub longest_pause: Span,
    /// First pause after a refusal; each further pause is twice as long.
    pub refused_pause: Span,
    /// Time without an acknowledgement after which a hello is sent again.
    pub ack_timeout: Span,
    /// Pause before the spool is tried again after a failure.
    pub spool_pause: Span,
}

impl Default for SendingConfig {
    fn default() -> Self {
        Self {
            batch_nodes: 8192,
            batch_bytes: 128 * 1024,
            batch_age: Span::from_millis(200),
            window: 8,
            spool_bytes: 1 << 30,
            memory: Usage { events: 50_000, bytes: 32 << 20 },
            reserve_events: 1024,
            compression: Compression::Auto,
            first_pause: Span::from_millis(250),
            longest_pause: Span::from_seconds(10),
            refused_pause: Span::from_seconds(1),
            ack_timeout: Span::from_seconds(10),
            spool_pause: Span::from_seconds(1),
        }
    }
}
