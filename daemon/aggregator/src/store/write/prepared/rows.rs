//! Rows of the tables that grow with every iteration. What is not known is not-a-number: SQLite keeps that as NULL.

/// One row of `iteration`.
#[derive(Debug)]
pub(in crate::store::write) struct IterationRow {
    /// Position in the batch's runs.
    pub(in crate::store::write) run: u32,
    pub(in crate::store::write) number: i64,
    pub(in crate::store::write) episode: u32,
    pub(in crate::store::write) step: u32,
    pub(in crate::store::write) warm_up: bool,
    pub(in crate::store::write) outcome: u8,
    pub(in crate::store::write) reason: Option<String>,
    pub(in crate::store::write) started_ns: i64,
    pub(in crate::store::write) total: f64,
}

/// One row of `node`.
#[derive(Debug)]
pub(in crate::store::write) struct NodeRow {
    /// Position in the batch's iterations.
    pub(in crate::store::write) iteration: u32,
    pub(in crate::store::write) node: u32,
    /// `None` for the root.
    pub(in crate::store::write) parent: Option<u32>,
    /// Position in the batch's names.
    pub(in crate::store::write) name: u32,
    pub(in crate::store::write) host: u8,
    pub(in crate::store::write) start_ns: i64,
    pub(in crate::store::write) value: f64,
    pub(in crate::store::write) lo: f64,
    pub(in crate::store::write) hi: f64,
}

/// One row of `anchor`.
#[derive(Debug)]
pub(in crate::store::write) struct AnchorRow {
    pub(in crate::store::write) iteration: u32,
    pub(in crate::store::write) position: u8,
    /// Position in the batch's hosts.
    pub(in crate::store::write) host: u32,
    pub(in crate::store::write) wall_ns: i64,
}

/// One row of `transit`.
#[derive(Debug)]
pub(in crate::store::write) struct TransitRow {
    pub(in crate::store::write) iteration: u32,
    pub(in crate::store::write) node: u32,
    pub(in crate::store::write) sent_ns: i64,
    pub(in crate::store::write) received_ns: Option<i64>,
    pub(in crate::store::write) raw_ns: Option<i64>,
    pub(in crate::store::write) source: Option<u8>,
    pub(in crate::store::write) verdict: Option<u8>,
}
