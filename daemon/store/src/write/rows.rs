//! Statements that insert the rows of iterations directly from the batches.

use peernet_analysis::rows::Outcome;
use sqlx::error::BoxDynError;
use sqlx::sqlite::SqliteArguments;
use sqlx::{Arguments, SqliteConnection};

use super::prepared::{AnchorRow, IterationRow, NodeRow, PreparedBatch, TransitRow, position};
use crate::insert::Insert;
use crate::rollups::Rollups;

/// A batch with the ids of its runs, names and hosts in the database.
#[derive(Debug)]
pub(super) struct ResolvedBatch<'a> {
    pub(super) batch: &'a PreparedBatch,
    pub(super) runs: Vec<i64>,
    pub(super) names: Vec<i64>,
    pub(super) hosts: Vec<i64>,
}

impl ResolvedBatch<'_> {
    /// Adds the statistics of the batch to the roll-ups.
    fn add_to_rollups(&self, rollups: &mut Rollups) {
        for part in &self.batch.summaries {
            let (run, name) = (self.runs[part.run as usize], self.names[part.name as usize]);
            rollups.merge(run, name, part.quantity, part.second_s, &part.summary);
        }
        for (run, name, verdict, count) in &self.batch.verdicts {
            rollups.add_verdicts(self.runs[*run as usize], self.names[*name as usize], *verdict, *count);
        }
    }

    /// Returns the run and the number of the iteration at a position in the batch.
    fn iteration(&self, position: u32) -> (i64, i64) {
        let row = &self.batch.iterations[position as usize];
        (self.runs[row.run as usize], row.number)
    }
}

/// Statements of the four tables that grow with every iteration.
#[derive(Debug)]
pub(super) struct Inserts {
    iterations: Insert,
    nodes: Insert,
    anchors: Insert,
    transits: Insert,
}

impl Default for Inserts {
    fn default() -> Self {
        Self {
            iterations: Insert::new(
                "INSERT INTO iteration (run, number, episode, step, warm_up, outcome, reason, started_ns, total)",
                9,
                "",
            ),
            nodes: Insert::new(
                "INSERT INTO node (run, iteration, node, parent, name, host, start_ns, value, lo, hi)",
                10,
                "",
            ),
            anchors: Insert::new("INSERT INTO anchor (run, iteration, position, host, wall_ns)", 5, ""),
            transits: Insert::new(
                "INSERT INTO transit (run, iteration, node, sent_ns, received_ns, raw_ns, source, verdict, sent_raw_ns, \
                 received_raw_ns)",
                10,
                "",
            ),
        }
    }
}

impl Inserts {
    /// Inserts the rows of all batches, and adds their statistics to the roll-ups while SQLite executes.
    pub(super) async fn run(
        &self,
        connection: &mut SqliteConnection,
        batches: &[ResolvedBatch<'_>],
        rollups: &mut Rollups,
    ) -> Result<(), sqlx::Error> {
        let iterations = Rows::new(batches, |batch| &batch.iterations);
        self.iterations.run(connection, iterations, bind_iteration).await?;
        let nodes = Rows::new(batches, |batch| &batch.nodes);
        let bind = |(batch, row): (&ResolvedBatch<'_>, &NodeRow), to: &mut SqliteArguments| {
            // The statistics of a batch are added to the roll-ups when the batch's first node is bound. At this time
            // SQLite's thread executes the previous statement, so the addition delays nothing.
            if (row.iteration, row.node) == (0, 0) {
                batch.add_to_rollups(rollups);
            }
            bind_node((batch, row), to)
        };
        self.nodes.run(connection, nodes, bind).await?;
        let anchors = Rows::new(batches, |batch| &batch.anchors);
        self.anchors.run(connection, anchors, bind_anchor).await?;
        let transits = Rows::new(batches, |batch| &batch.transits);
        self.transits.run(connection, transits, bind_transit).await
    }
}

fn bind_iteration(
    (batch, row): (&ResolvedBatch<'_>, &IterationRow),
    to: &mut SqliteArguments,
) -> Result<(), BoxDynError> {
    to.add(batch.runs[row.run as usize])?;
    to.add(row.number)?;
    to.add(row.episode)?;
    to.add(row.step)?;
    to.add(row.warm_up)?;
    to.add(position(&Outcome::ALL, row.outcome))?;
    to.add(row.reason.as_deref())?;
    to.add(row.started_ns)?;
    to.add(row.total)
}

fn bind_node(
    (batch, row): (&ResolvedBatch<'_>, &NodeRow),
    to: &mut SqliteArguments,
) -> Result<(), BoxDynError> {
    let (run, iteration) = batch.iteration(row.iteration);
    to.add(run)?;
    to.add(iteration)?;
    to.add(row.node)?;
    to.add(row.parent)?;
    to.add(batch.names[row.name as usize])?;
    // The column `host` has the position of the host's anchor, not the id of the host.
    to.add(row.anchor)?;
    to.add(row.start_ns)?;
    to.add(row.value)?;
    to.add(row.lo)?;
    to.add(row.hi)
}

fn bind_anchor(
    (batch, row): (&ResolvedBatch<'_>, &AnchorRow),
    to: &mut SqliteArguments,
) -> Result<(), BoxDynError> {
    let (run, iteration) = batch.iteration(row.iteration);
    to.add(run)?;
    to.add(iteration)?;
    to.add(row.position)?;
    to.add(batch.hosts[row.host as usize])?;
    to.add(row.wall_ns)
}

fn bind_transit(
    (batch, row): (&ResolvedBatch<'_>, &TransitRow),
    to: &mut SqliteArguments,
) -> Result<(), BoxDynError> {
    let (run, iteration) = batch.iteration(row.iteration);
    to.add(run)?;
    to.add(iteration)?;
    to.add(row.node)?;
    to.add(row.sent_ns)?;
    to.add(row.received_ns)?;
    to.add(row.stamp_difference_ns)?;
    to.add(row.source)?;
    to.add(row.verdict)?;
    to.add(row.free_running_stamps.map(|(sent, _)| sent))?;
    to.add(row.free_running_stamps.map(|(_, received)| received))
}

/// The rows of one table in all batches, one batch after the other.
struct Rows<'a, R, F> {
    batches: std::slice::Iter<'a, ResolvedBatch<'a>>,
    /// Returns the rows of a batch.
    rows_of: F,
    /// The current batch with its remaining rows.
    current: Option<(&'a ResolvedBatch<'a>, std::slice::Iter<'a, R>)>,
    /// Number of remaining rows of all batches.
    remaining: usize,
}

impl<'a, R, F: Fn(&'a PreparedBatch) -> &'a Vec<R>> Rows<'a, R, F> {
    fn new(batches: &'a [ResolvedBatch<'a>], rows_of: F) -> Self {
        let remaining = batches.iter().map(|batch| rows_of(batch.batch).len()).sum();
        Self { batches: batches.iter(), rows_of, current: None, remaining }
    }
}

impl<'a, R, F: Fn(&'a PreparedBatch) -> &'a Vec<R>> Iterator for Rows<'a, R, F> {
    type Item = (&'a ResolvedBatch<'a>, &'a R);

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some((batch, rows)) = &mut self.current
                && let Some(row) = rows.next()
            {
                self.remaining -= 1;
                return Some((*batch, row));
            }
            let batch = self.batches.next()?;
            self.current = Some((batch, (self.rows_of)(batch.batch).iter()));
        }
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        (self.remaining, Some(self.remaining))
    }
}

impl<'a, R, F: Fn(&'a PreparedBatch) -> &'a Vec<R>> ExactSizeIterator for Rows<'a, R, F> {}
