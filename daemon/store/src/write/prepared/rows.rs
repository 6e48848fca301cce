//! Rows of the tables that grow with every iteration. An unknown `f64` is NaN, which SQLite stores as
//! NULL.

use peernet_analysis::rows::Outcome;

/// A row of `iteration`.
#[derive(Debug)]
pub(in crate::write) struct IterationRow {
    /// Position in the batch's runs.
    pub(in crate::write) run: u32,
    pub(in crate::write) number: i64,
    pub(in crate::write) episode: u32,
    pub(in crate::write) step: u32,
    pub(in crate::write) warm_up: bool,
    pub(in crate::write) outcome: Outcome,
    pub(in crate::write) reason: Option<String>,
    pub(in crate::write) started_ns: i64,
    pub(in crate::write) total: f64,
}

/// A row of `node`.
#[derive(Debug)]
pub(in crate::write) struct NodeRow {
    /// Position in the batch's iterations.
    pub(in crate::write) iteration: u32,
    pub(in crate::write) node: u32,
    /// Position of the parent in the tree; `None` for the root.
    pub(in crate::write) parent: Option<u32>,
    /// Position in the batch's names.
    pub(in crate::write) name: u32,
    /// Position in the iteration's anchors: that of the node's host.
    pub(in crate::write) anchor: u8,
    pub(in crate::write) start_ns: i64,
    pub(in crate::write) value: f64,
    pub(in crate::write) lo: f64,
    pub(in crate::write) hi: f64,
}

/// A row of `anchor`.
#[derive(Debug)]
pub(in crate::write) struct AnchorRow {
    /// Position in the batch's iterations.
    pub(in crate::write) iteration: u32,
    /// Position in the iteration's anchors. The edge's anchor, at position 0, has no row.
    pub(in crate::write) position: u8,
    /// Position in the batch's hosts.
    pub(in crate::write) host: u32,
    pub(in crate::write) wall_ns: i64,
}

/// A row of `transit`.
#[derive(Debug)]
pub(in crate::write) struct TransitRow {
    pub(in crate::write) iteration: u32,
    pub(in crate::write) node: u32,
    pub(in crate::write) sent_ns: i64,
    pub(in crate::write) received_ns: Option<i64>,
    /// Receive stamp minus send stamp, each on its own host's clock; `None` if the delay was not judged.
    pub(in crate::write) stamp_difference_ns: Option<i64>,
    pub(in crate::write) source: Option<u8>,
    pub(in crate::write) verdict: Option<u8>,
    /// Stamps of the free-running clocks: sent, received.
    pub(in crate::write) free_running_stamps: Option<(i64, i64)>,
}
