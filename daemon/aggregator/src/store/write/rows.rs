//! Rows that wait to be inserted together, and how each table takes them.

use sqlx::error::BoxDynError;
use sqlx::sqlite::SqliteArguments;
use sqlx::{Arguments, SqliteConnection};

use super::insert::Insert;

/// One row of `iteration`.
#[derive(Debug)]
pub(super) struct IterationRow {
    pub(super) run: i64,
    pub(super) number: i64,
    pub(super) episode: u32,
    pub(super) step: u32,
    pub(super) warm_up: bool,
    pub(super) outcome: u8,
    pub(super) reason: Option<String>,
    pub(super) started_ns: i64,
    pub(super) total: Option<f64>,
}

/// One row of `node`.
#[derive(Debug)]
pub(crate) struct NodeRow {
    pub(crate) run: i64,
    pub(crate) iteration: i64,
    pub(crate) node: u32,
    pub(crate) parent: Option<u32>,
    pub(crate) name: i64,
    pub(crate) host: u8,
    pub(crate) start_ns: i64,
    pub(crate) value: Option<f64>,
    pub(crate) lo: Option<f64>,
    pub(crate) hi: Option<f64>,
}

/// One row of `anchor`.
#[derive(Debug)]
pub(super) struct AnchorRow {
    pub(super) run: i64,
    pub(super) iteration: i64,
    pub(super) position: u8,
    pub(super) host: i64,
    pub(super) wall_ns: i64,
}

/// One row of `transit`.
#[derive(Debug)]
pub(super) struct TransitRow {
    pub(super) run: i64,
    pub(super) iteration: i64,
    pub(super) node: u32,
    pub(super) sent_ns: i64,
    pub(super) received_ns: Option<i64>,
    pub(super) raw_ns: Option<i64>,
    pub(super) source: Option<u8>,
    pub(super) verdict: Option<u8>,
}

/// Rows of all tables that grow with every iteration.
#[derive(Debug, Default)]
pub(super) struct Rows {
    pub(super) iterations: Vec<IterationRow>,
    pub(super) nodes: Vec<NodeRow>,
    pub(super) anchors: Vec<AnchorRow>,
    pub(super) transits: Vec<TransitRow>,
}

/// The statements that insert them.
#[derive(Debug)]
pub(super) struct Inserts {
    iterations: Insert,
    nodes: Insert,
    anchors: Insert,
    transits: Insert,
}

/// The statement for nodes, also for the benchmark's bare loop.
pub(crate) fn node_insert() -> Insert {
    Insert::new(
        "INSERT INTO node (run, iteration, node, parent, name, host, start_ns, value, lo, hi)",
        10,
        "",
    )
}

/// Adds a node's values in the order of [`node_insert`].
pub(crate) fn bind_node(row: &NodeRow, to: &mut SqliteArguments) -> Result<(), BoxDynError> {
    to.add(row.run)?;
    to.add(row.iteration)?;
    to.add(row.node)?;
    to.add(row.parent)?;
    to.add(row.name)?;
    to.add(row.host)?;
    to.add(row.start_ns)?;
    to.add(row.value)?;
    to.add(row.lo)?;
    to.add(row.hi)
}

impl Default for Inserts {
    fn default() -> Self {
        Self {
            iterations: Insert::new(
                "INSERT INTO iteration (run, number, episode, step, warm_up, outcome, reason, started_ns, total)",
                9,
                "",
            ),
            nodes: node_insert(),
            anchors: Insert::new("INSERT INTO anchor (run, iteration, position, host, wall_ns)", 5, ""),
            transits: Insert::new(
                "INSERT INTO transit (run, iteration, node, sent_ns, received_ns, raw_ns, source, verdict)",
                8,
                "",
            ),
        }
    }
}

impl Inserts {
    /// Inserts everything that waits and empties `rows`, keeping their memory for the next commit.
    pub(super) async fn run(
        &self,
        connection: &mut SqliteConnection,
        rows: &mut Rows,
    ) -> Result<(), sqlx::Error> {
        self.iterations
            .run(connection, &rows.iterations, |row, to| {
                to.add(row.run)?;
                to.add(row.number)?;
                to.add(row.episode)?;
                to.add(row.step)?;
                to.add(row.warm_up)?;
                to.add(row.outcome)?;
                to.add(row.reason.as_deref())?;
                to.add(row.started_ns)?;
                to.add(row.total)
            })
            .await?;
        self.nodes.run(connection, &rows.nodes, bind_node).await?;
        self.anchors
            .run(connection, &rows.anchors, |row, to| {
                to.add(row.run)?;
                to.add(row.iteration)?;
                to.add(row.position)?;
                to.add(row.host)?;
                to.add(row.wall_ns)
            })
            .await?;
        self.transits
            .run(connection, &rows.transits, |row, to| {
                to.add(row.run)?;
                to.add(row.iteration)?;
                to.add(row.node)?;
                to.add(row.sent_ns)?;
                to.add(row.received_ns)?;
                to.add(row.raw_ns)?;
                to.add(row.source)?;
                to.add(row.verdict)
            })
            .await?;
        rows.clear();
        Ok(())
    }
}

impl Rows {
    /// Drops what waits.
    pub(super) fn clear(&mut self) {
        self.iterations.clear();
        self.nodes.clear();
        self.anchors.clear();
        self.transits.clear();
    }
}
