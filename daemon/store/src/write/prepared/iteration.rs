//! Conversion of a tree to rows and statistics.

use peernet_analysis::actuator_results::is_value_in_statistics;
use peernet_analysis::outcomes::Counts;
use peernet_analysis::rows;
use peernet_clock::{DelaySource, Verdict, WallTime};
use peernet_logger::{HostId, Measure, NodeId, Transit, stage};
use peernet_stream::{Iteration, Outcome};

use super::{AnchorRow, BatchBuilder, BatchError, IterationRow, NodeRow, RunPart, Step, TransitRow};
use crate::extent::Extent;
use crate::rollups::Quantity;

impl BatchBuilder {
    /// Adds an iteration; returns the time of its start.
    pub(super) fn add_iteration(&mut self, iteration: &Iteration) -> Result<WallTime, BatchError> {
        let number =
            i64::try_from(iteration.number).map_err(|_| BatchError::IterationNumber(iteration.number))?;
        let tree = &iteration.tree;
        let [edge, other_anchors @ ..] = tree.anchors() else {
            return Err(BatchError::EmptyTree(number));
        };
        // The nodes that statistics of their names include.
        let counted_nodes = tree.counted_nodes();
        let run = self.add_to_run(iteration, edge.wall, counted_nodes.get(&stage::SKIPPED_STARTS));
        let index = self.batch.iterations.len() as u32;
        // The edge's anchor needs no row: its host is the host of the run, and its time is the start of the iteration.
        for (position, anchor) in (1..).zip(other_anchors) {
            let (host, wall_ns) = (self.host_position(anchor.host), anchor.wall.unix_nanos());
            self.batch.anchors.push(AnchorRow { iteration: index, position, host, wall_ns });
        }
        let is_in_statistics = iteration.outcome == Outcome::Ok && !iteration.warm_up;
        let second_s = edge.wall.unix_seconds();
        let first_node = self.batch.nodes.len();
        for (id, node) in tree.iter() {
            // SQLite stores NaN as NULL.
            let (lo, hi) = bounds(&node.measure).unwrap_or((f64::NAN, f64::NAN));
            self.batch.nodes.push(NodeRow {
                iteration: index,
                node: id.0,
                parent: node.parent.map(|NodeId(parent)| parent),
                name: self.names.position(id.index(), &node.name, &node.measure),
                anchor: node.host.0,
                start_ns: node.start.nanos(),
                value: node.measure.value().unwrap_or(f64::NAN),
                lo,
                hi,
            });
            if let Measure::Transit(transit) = &node.measure {
                self.batch.transits.push(transit_row(index, id, transit));
            }
        }
        for (id, node, value) in counted_nodes.iter() {
            let name = self.batch.nodes[first_node + id.index()].name;
            // Values of episodes are in the statistics even if the iteration is not.
            if let Some(value) = value
                && is_value_in_statistics(&node.name, is_in_statistics)
            {
                self.summaries.record(run, name, Quantity::Value, second_s, value);
                if is_in_statistics && let Some((lo, hi)) = bounds(&node.measure) {
                    self.summaries.record(run, name, Quantity::LowerEnd, second_s, lo);
                    self.summaries.record(run, name, Quantity::UpperEnd, second_s, hi);
                }
            }
            if let (true, Measure::Transit(transit)) = (is_in_statistics, &node.measure)
                && let Some(delay) = transit.delay
                && let Some(verdict) = position(Verdict::ALL, delay.verdict)
            {
                *self.verdicts.entry((run, name, verdict)).or_default() += 1;
                // The statistics omit the NaN of a delay without a half width.
                let half_width = delay.half_width().unwrap_or(f64::NAN);
                self.summaries.record(run, name, Quantity::HalfWidth, second_s, half_width);
            }
        }
        self.batch.iterations.push(IterationRow {
            run,
            number,
            episode: iteration.episode,
            step: iteration.step,
            warm_up: iteration.warm_up,
            outcome: rows::Outcome::from(&iteration.outcome),
            reason: iteration.outcome.reason().map(str::to_owned),
            started_ns: edge.wall.unix_nanos(),
            total: counted_nodes.get(&stage::TOTAL).unwrap_or(f64::NAN),
        });
        Ok(edge.wall)
    }

    /// Adds the iteration to the counters of its run. `skipped_starts` is the number of starts that were skipped before
    /// the iteration. Returns the position of the run in the batch's runs.
    fn add_to_run(&mut self, iteration: &Iteration, started: WallTime, skipped_starts: Option<f64>) -> u32 {
        let numbers = Extent::single(iteration.number.cast_signed());
        let seconds = Extent::single(started.unix_seconds());
        let batch = &mut self.batch;
        let run = *self.runs.entry(iteration.run).or_insert_with(|| {
            let run = batch.runs.len() as u32;
            batch.steps.push(Step::Run(run, started));
            batch.runs.push(RunPart {
                id: iteration.run,
                counts: Counts::default(),
                skipped_starts: 0,
                newest_start: started,
                numbers,
                seconds,
            });
            run
        });
        let part = &mut batch.runs[run as usize];
        part.newest_start = part.newest_start.max(started);
        part.numbers = part.numbers.hull(numbers);
        part.seconds = part.seconds.hull(seconds);
        if !iteration.warm_up {
            // The cast saturates: values that are no counts become 0 or the largest count.
            part.skipped_starts = part.skipped_starts.saturating_add(skipped_starts.unwrap_or(0.0) as u64);
        }
        part.counts.add(&iteration.outcome, iteration.warm_up);
        run
    }

    /// Returns the position of a host other than the edge in the batch's hosts.
    fn host_position(&mut self, host: HostId) -> u32 {
        *self.hosts.entry(host).or_insert_with(|| {
            self.batch.hosts.push(host);
            self.batch.hosts.len() as u32 - 1
        })
    }
}

/// Returns the bounds of a node's value.
fn bounds(measure: &Measure) -> Option<(f64, f64)> {
    match measure {
        Measure::Transit(transit) => {
            transit.delay?.bounds.map(|bounds| (bounds.lo.seconds(), bounds.hi.seconds()))
        }
        Measure::Throughput(rate) => rate.bounds,
        _ => None,
    }
}

fn transit_row(iteration: u32, id: NodeId, transit: &Transit) -> TransitRow {
    let delay = transit.delay;
    TransitRow {
        iteration,
        node: id.0,
        sent_ns: transit.sent.unix_nanos(),
        received_ns: transit.received.map(WallTime::unix_nanos),
        stamp_difference_ns: delay.map(|delay| delay.raw.nanos()),
        source: delay.and_then(|delay| position(DelaySource::ALL, delay.source)),
        verdict: delay.and_then(|delay| position(Verdict::ALL, delay.verdict)),
        free_running_stamps: transit.raw_stamps.map(|stamps| (stamps.sent.nanos(), stamps.received.nanos())),
    }
}

/// Returns the number under which the database stores a value of an enumeration, which is the value's position in `all`.
/// The tables `outcome`, `source` and `verdict` have the same numbers.
pub(crate) fn position<T: PartialEq + Copy>(all: &[T], value: T) -> Option<u8> {
    all.iter().position(|other| *other == value).and_then(|position| u8::try_from(position).ok())
}
