//! Making roll-ups from stored nodes, by the same rules as the writer.

use std::collections::HashMap;

use futures::TryStreamExt as _;
use peernet_logger::{IterationValues, NodeId, NodeRole};
use peernet_statistics::Summary;
use sqlx::{FromRow, SqliteConnection};

use crate::rollups::{Quantity, Rollups};

/// Number of iterations of a page. One page is read at a time.
const PAGE_ITERATIONS: i64 = 500;
/// Number of pending summaries at which all pending summaries are written.
const MAX_PENDING_SUMMARIES: usize = 20_000;

/// The last iteration of a page, and the number of iterations that statistics include: ?1 run, ?2 the last iteration of
/// the previous page, ?3 limit.
pub(super) const PAGE: &str = "SELECT max(number), count(*) FILTER (WHERE warm_up = 0 AND outcome = 0) FROM \
     (SELECT number, warm_up, outcome FROM iteration WHERE run = ?1 AND number > ?2 ORDER BY number LIMIT ?3)";
/// The nodes of the successful iterations of a page, without the warm-up, and the success and return of episodes from
/// all iterations of the page: ?1 run, ?2 last iteration of the previous page, ?3 last iteration of this page. The
/// joins follow the key that all these tables have: run, iteration, node.
// `CROSS JOIN` keeps SQLite from reordering the joins. The unary `+` keeps it from using another index than this key.
pub(super) const NODES: &str = "SELECT node.iteration, iteration.started_ns, node.node, node.parent, node.name, \
     (SELECT text FROM name WHERE id = node.name) AS text, node.value, node.lo, node.hi, transit.verdict \
     FROM iteration CROSS JOIN node ON node.run = iteration.run AND node.iteration = iteration.number \
     LEFT JOIN transit ON transit.run = node.run AND transit.iteration = node.iteration AND transit.node = node.node \
     WHERE iteration.run = ?1 AND iteration.number > ?2 AND iteration.number <= ?3 \
     AND (+iteration.warm_up = 0 AND +iteration.outcome = 0 \
     OR +node.name IN (SELECT id FROM name WHERE text IN ('episode-success', 'episode-return'))) \
     ORDER BY iteration.number, node.node";

#[derive(FromRow)]
struct NodeRow {
    iteration: i64,
    started_ns: i64,
    node: u32,
    parent: Option<u32>,
    /// Id of the name.
    name: i64,
    text: String,
    value: Option<f64>,
    lo: Option<f64>,
    hi: Option<f64>,
    verdict: Option<u8>,
}

/// Statistics of the iterations of a page.
#[derive(Default)]
struct PageStatistics {
    summaries: HashMap<(i64, Quantity, i64), Summary>,
    verdicts: HashMap<(i64, u8), u64>,
}

impl PageStatistics {
    /// Adds the nodes of an iteration. `rows` are in the order of the tree.
    fn add_iteration(&mut self, rows: &[NodeRow]) {
        let mut values = IterationValues::default();
        let add = |row: &NodeRow| values.add(NodeId(row.node), row.parent.map(NodeId), &row.text, row.value);
        let roles: Vec<NodeRole> = rows.iter().map(add).collect();
        for (row, role) in rows.iter().zip(roles) {
            let second_s = row.started_ns.div_euclid(1_000_000_000);
            let mut record = |quantity, value| {
                self.summaries.entry((row.name, quantity, second_s)).or_default().record(value);
            };
            if let Some(value) = values.counted(NodeId(row.node), role, row.value) {
                record(Quantity::Value, value);
                if let (Some(lo), Some(hi)) = (row.lo, row.hi) {
                    record(Quantity::LowerEnd, lo);
                    record(Quantity::UpperEnd, hi);
                }
            }
            if let Some(verdict) = row.verdict.filter(|_| role != NodeRole::Nested) {
                *self.verdicts.entry((row.name, verdict)).or_default() += 1;
                // As in `OneWayDelay::half_width`, only delays with a value have a half width.
                if let (Some(_), Some(lo), Some(hi)) = (row.value, row.lo, row.hi) {
                    record(Quantity::HalfWidth, (hi - lo) / 2.0);
                }
            }
        }
    }
}

/// Adds the stored nodes of a run to `rollups`, and writes them. `first_complete_s` is the second before which the nodes
/// of the run are deleted; `None` if none is deleted. The caller restricts `rollups` to buckets of which no node is
/// deleted ([`Rollups::with_scope`]). `progress` is called after each page with the number of its iterations that
/// statistics include.
///
/// Verdicts are counted over the whole run, so they are written only if `first_complete_s` is `None`.
pub(super) async fn write_rollups(
    connection: &mut SqliteConnection,
    run: i64,
    first_complete_s: Option<i64>,
    rollups: &mut Rollups,
    mut progress: impl FnMut(u64),
) -> Result<(), sqlx::Error> {
    let mut previous_last = i64::MIN;
    loop {
        let (last, included): (Option<i64>, i64) = sqlx::query_as(PAGE)
            .bind(run)
            .bind(previous_last)
            .bind(PAGE_ITERATIONS)
            .fetch_one(&mut *connection)
            .await?;
        let Some(last) = last else { break };
        let mut statistics = PageStatistics::default();
        let mut iteration_rows = Vec::<NodeRow>::new();
        let mut rows = sqlx::query_as(NODES).bind(run).bind(previous_last).bind(last).fetch(&mut *connection);
        while let Some(row) = rows.try_next().await? {
            let row: NodeRow = row;
            if iteration_rows.last().is_some_and(|previous| previous.iteration != row.iteration) {
                statistics.add_iteration(&iteration_rows);
                iteration_rows.clear();
            }
            iteration_rows.push(row);
        }
        statistics.add_iteration(&iteration_rows);
        drop(rows);
        let PageStatistics { summaries, verdicts } = statistics;
        for ((name, quantity, second_s), summary) in summaries {
            rollups.merge(run, name, quantity, second_s, &summary);
        }
        if first_complete_s.is_none() {
            for ((name, verdict), count) in verdicts {
                rollups.add_verdicts(run, name, verdict, count);
            }
        }
        if rollups.pending_summaries() >= MAX_PENDING_SUMMARIES {
            rollups.write(connection).await?;
        }
        progress(included.unsigned_abs());
        previous_last = last;
    }
    rollups.write(connection).await
}
