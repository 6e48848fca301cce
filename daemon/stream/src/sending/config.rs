//! How events are batched, kept and sent.

use peernet_clock::Span;

use super::super::spool::Usage;

/// Whether batches are compressed on their way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compression {
    /// While the link is what batches wait for.
    #[default]
    Auto,
    /// Every batch.
    Always,
    /// None.
    Never,
}

/// How events are batched, kept and sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SendingConfig {
    /// A batch is cut when it holds so many nodes.
    pub batch_nodes: usize,
    /// A batch is cut before it takes more bytes than this (a single larger event is a batch of its own).
    pub batch_bytes: usize,
    /// A batch is cut when its first event is this old.
    pub batch_age: Span,
    /// What may be under way and not acknowledged, in units of `batch_bytes`; the aggregator may allow less.
    pub window: u32,
    /// Bytes of bodies that the spool may hold.
    pub spool_bytes: u64,
    /// What may wait in memory because it is not in the spool yet.
    pub memory: Usage,
    /// Places of the memory that iterations leave to the other events: an iteration is worth nothing without the
    /// start of its run. Must be well below `memory`, or no iteration ever fits.
    pub reserve_events: u64,
    /// Whether batches are compressed.
    pub compression: Compression,
    /// The first pause before a hello is repeated; each is twice the one before.
    pub first_pause: Span,
    /// The longest such pause.
    pub longest_pause: Span,
    /// The first pause after a refusal; the others follow the same rule.
    pub refused_pause: Span,
    /// Without an acknowledgement for so long, the connection is opened anew.
    pub patience: Span,
    /// The pause before the spool is tried again after it failed.
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
            patience: Span::from_seconds(10),
            spool_pause: Span::from_seconds(1),
        }
    }
}
