//! From a tree to rows.

use std::collections::HashMap;

use peernet_clock::{DelaySource, Verdict, WallTime};
use peernet_logger::stream::{Iteration, Outcome, OutcomeCounts};
use peernet_logger::{HostId, Measure, Node, NodeId, stage};
use sqlx::SqliteConnection;

use super::Refusal;
use super::entities::{Entities, KnownRun};
use super::names::Names;
use super::rollups::{Quantity, Rollups};
use super::rows::{AnchorRow, IterationRow, NodeRow, Rows, TransitRow};

/// What a transaction adds to the counters of a run.
#[derive(Debug, Default)]
pub(super) struct RunCounts {
    pub(super) outcomes: OutcomeCounts,
    pub(super) warm_up: u64,
    pub(super) last: WallTime,
}

/// Turns iterations into rows and statistics.
#[derive(Debug, Default)]
pub(super) struct Staging {
    pub(super) rows: Rows,
    pub(super) rollups: Rollups,
    pub(super) names: Names,
    pub(super) runs: HashMap<i64, RunCounts>,
}

impl Staging {
    /// Adds an iteration of a host; its rows wait for the transaction's end.
    pub(super) async fn add(
        &mut self,
        connection: &mut SqliteConnection,
        entities: &mut Entities,
        (host, run): (HostId, KnownRun),
        iteration: &Iteration,
        now: WallTime,
    ) -> Result<(), Refusal> {
        let run = run.number;
        let number = i64::try_from(iteration.number)
            .map_err(|_| Refusal::Batch(format!("iteration number {} is too large", iteration.number)))?;
        let tree = &iteration.tree;
        let [edge, others @ ..] = tree.anchors() else {
            return Err(Refusal::Batch(format!("iteration {number} has no host")));
        };
        if edge.host != host {
            return Err(Refusal::Batch(format!("iteration {number} began on another host, {}", edge.host)));
        }
        for (position, anchor) in (1..).zip(others) {
            let host = entities.host(connection, anchor.host, now).await?;
            let wall_ns = anchor.wall.unix_nanos();
            self.rows.anchors.push(AnchorRow { run, iteration: number, position, host, wall_ns });
        }
        let counted = iteration.outcome == Outcome::Ok && !iteration.warm_up;
        let started_s = edge.wall.unix_seconds();
        for (id, node) in tree.iter() {
            let name = self.names.id(connection, &node.name, &node.measure).await?;
            let (lo, hi) = bounds(&node.measure).unzip();
            let value = node.measure.value();
            self.rows.nodes.push(NodeRow {
                run,
                iteration: number,
                node: id.0,
                parent: node.parent.map(|NodeId(parent)| parent),
                name,
                host: node.host.0,
                start_ns: node.start.nanos(),
                value,
                lo,
                hi,
            });
            if let Some(transit) = transit_row(run, number, id, node) {
                if let (true, Some(verdict)) = (counted, transit.verdict) {
                    self.rollups.judge(run, name, verdict);
                    if let Some((lo, hi)) = bounds(&node.measure) {
                        self.rollups.record(run, name, Quantity::HalfWidth, started_s, (hi - lo) / 2.0);
                    }
                }
                self.rows.transits.push(transit);
            }
            if let (true, Some(value)) = (counted, value) {
                self.rollups.record(run, name, Quantity::Value, started_s, value);
            }
        }
        self.rows.iterations.push(IterationRow {
            run,
            number,
            episode: iteration.episode,
            step: iteration.step,
            warm_up: iteration.warm_up,
            outcome: outcome_number(&iteration.outcome),
            reason: iteration.outcome.reason().map(str::to_owned),
            started_ns: edge.wall.unix_nanos(),
            total: tree.find(&[stage::TOTAL.as_str()]).and_then(|(_, node)| node.measure.value()),
        });
        self.count(run, iteration, edge.wall);
        Ok(())
    }

    fn count(&mut self, run: i64, iteration: &Iteration, started: WallTime) {
        let counts = self.runs.entry(run).or_default();
        counts.last = counts.last.max(started);
        let outcomes = &mut counts.outcomes;
        let counter = match &iteration.outcome {
            _ if iteration.warm_up => &mut counts.warm_up,
            Outcome::Ok => &mut outcomes.ok,
            Outcome::Failed(_) => &mut outcomes.failed,
            Outcome::Lost(_) => &mut outcomes.lost,
            Outcome::Timeout => &mut outcomes.timeout,
        };
        *counter += 1;
    }

    /// Drops what waits: the transaction did not end well.
    pub(super) fn forget(&mut self) {
        self.rows.clear();
        self.rollups.forget();
        self.runs.clear();
    }
}

/// Row of the table `outcome`.
pub(crate) const fn outcome_number(outcome: &Outcome) -> u8 {
    match outcome {
        Outcome::Ok => 0,
        Outcome::Failed(_) => 1,
        Outcome::Lost(_) => 2,
        Outcome::Timeout => 3,
    }
}

fn bounds(measure: &Measure) -> Option<(f64, f64)> {
    match measure {
        Measure::Transit(transit) => {
            transit.delay?.bounds.map(|bounds| (bounds.lo.seconds(), bounds.hi.seconds()))
        }
        Measure::Throughput(rate) => rate.bounds,
        _ => None,
    }
}

fn transit_row(run: i64, iteration: i64, id: NodeId, node: &Node) -> Option<TransitRow> {
    let Measure::Transit(transit) = &node.measure else { return None };
    let delay = transit.delay;
    Some(TransitRow {
        run,
        iteration,
        node: id.0,
        sent_ns: transit.sent.unix_nanos(),
        received_ns: transit.received.map(WallTime::unix_nanos),
        raw_ns: delay.map(|delay| delay.raw.nanos()),
        source: delay.and_then(|delay| position(DelaySource::ALL, delay.source)),
        verdict: delay.and_then(|delay| position(Verdict::ALL, delay.verdict)),
    })
}

/// Rows of the tables `source` and `verdict` stand in the order of declaration.
pub(super) fn position<T: PartialEq + Copy>(all: &[T], value: T) -> Option<u8> {
    all.iter().position(|known| *known == value).and_then(|at| u8::try_from(at).ok())
}
