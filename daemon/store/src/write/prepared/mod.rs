//! Preparation of batches: all work that needs no database is done here, in parallel with the writer and SQLite's
//! thread.
//!
//! Rows refer to runs, names and hosts by positions in lists of the batch; the writer looks up their ids in the
//! database. A batch that can never be stored is detected here.

mod iteration;
mod names;
mod rows;
mod summaries;

use std::collections::{BTreeSet, HashMap, HashSet};

use bytes::Bytes;
use peernet_analysis::outcomes::Counts;
use peernet_clock::WallTime;
use peernet_logger::{HostId, RunId};
use peernet_stream::codec::{self, CodecError};
use peernet_stream::{BatchHead, Event, EventOrigin};

use self::names::LocalNames;
pub(super) use self::names::NameKey;
pub(super) use self::rows::{AnchorRow, IterationRow, NodeRow, TransitRow};
use self::summaries::Summaries;
pub(super) use self::summaries::SummaryPart;
use crate::extent::Extent;
use crate::stored::StoredCounts;

pub(super) use self::iteration::position;

/// Maximum number of missing events in a gap. A host may report any number, and no sum in the database may overflow.
pub(super) const MAX_MISSING_EVENTS: u64 = 1 << 40;

/// A batch that is ready to be inserted.
#[derive(Debug)]
pub struct PreparedBatch {
    pub(super) head: BatchHead,
    /// The events in wire form, for the quarantine.
    pub(super) body: Bytes,
    /// Work to be done one by one, in the order of the events.
    pub(super) steps: Vec<Step>,
    pub(super) runs: Vec<RunPart>,
    /// Runs to which the batch's iterations and other events refer.
    pub(super) named_runs: BTreeSet<RunId>,
    pub(super) names: Vec<NameKey>,
    /// Hosts in the trees, without the edge.
    pub(super) hosts: Vec<HostId>,
    pub(super) iterations: Vec<IterationRow>,
    pub(super) nodes: Vec<NodeRow>,
    pub(super) anchors: Vec<AnchorRow>,
    pub(super) transits: Vec<TransitRow>,
    pub(super) summaries: Vec<SummaryPart>,
    /// Counts of verdicts: run, name, verdict, count.
    pub(super) verdicts: Vec<(u32, u32, u8, u64)>,
    /// Additions to the counters of the batch's host.
    pub(super) added: StoredCounts,
    /// Time of the batch's newest event on its host's clock.
    pub(super) newest: Option<WallTime>,
}

/// Work of the writer before the rows of iterations are inserted.
#[derive(Debug)]
pub(super) enum Step {
    /// An event other than an iteration.
    Event(Box<Event>),
    /// The run at this position in [`PreparedBatch::runs`] has iterations. The time is the start of the run's first
    /// iteration in the batch.
    Run(u32, WallTime),
}

/// A run with iterations in the batch, and its additions to the run's counters.
#[derive(Debug)]
pub(super) struct RunPart {
    pub(super) id: RunId,
    pub(super) counts: Counts,
    /// Number of starts that were skipped before these iterations. Starts before warm-up iterations do not count.
    pub(super) skipped_starts: u64,
    /// Start of the newest iteration.
    pub(super) newest_start: WallTime,
    pub(super) numbers: Extent,
    /// Range of the seconds in which the iterations started.
    pub(super) seconds: Extent,
}

/// Reason why a batch can never be stored, in any database.
#[derive(Debug, thiserror::Error)]
pub(crate) enum BatchError {
    /// The events cannot be decoded.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// An iteration's number does not fit into the database.
    #[error("iteration number {0} is too large")]
    IterationNumber(u64),
    /// The tree of an iteration is empty.
    #[error("the tree of iteration {0} is empty")]
    EmptyTree(i64),
    /// An event is about a measurement on another host.
    #[error("an event was measured on another host, {0}")]
    OtherHost(HostId),
}

impl PreparedBatch {
    /// Makes rows and statistics from the events of a batch.
    ///
    /// # Errors
    /// When the events cannot be decoded or cannot be stored.
    pub(crate) fn new(head: BatchHead, body: Bytes) -> Result<Self, BatchError> {
        Self::without_iterations(head, body, &HashSet::new())
    }

    /// Does the same as [`Self::new`], but leaves out the iterations in `stored`, because they are already stored.
    pub(super) fn without_iterations(
        head: BatchHead,
        body: Bytes,
        stored: &HashSet<(RunId, i64)>,
    ) -> Result<Self, BatchError> {
        let events = codec::decode_events(&body, head.events)?;
        let mut builder = BatchBuilder::new(Self::new_empty(head, body));
        for event in events {
            if let (false, Event::Iteration(iteration)) = (stored.is_empty(), &event)
                && stored.contains(&(iteration.run, iteration.number.cast_signed()))
            {
                builder.batch.added.events -= 1;
                continue;
            }
            builder.add(event)?;
        }
        Ok(builder.finish())
    }

    /// Returns the weight of the batch: 1 plus the numbers of its steps and nodes. The sizes of commits are limited by
    /// weight.
    pub(crate) fn weight(&self) -> usize {
        1 + self.steps.len() + self.nodes.len()
    }

    fn new_empty(head: BatchHead, body: Bytes) -> Self {
        Self {
            head,
            body,
            steps: Vec::new(),
            runs: Vec::new(),
            named_runs: BTreeSet::new(),
            names: Vec::new(),
            hosts: Vec::new(),
            iterations: Vec::new(),
            nodes: Vec::new(),
            anchors: Vec::new(),
            transits: Vec::new(),
            summaries: Vec::new(),
            verdicts: Vec::new(),
            added: StoredCounts { events: u64::from(head.events), ..StoredCounts::default() },
            newest: None,
        }
    }
}

/// A batch under preparation, with the positions of its items in its lists.
#[derive(Debug)]
struct BatchBuilder {
    batch: PreparedBatch,
    names: LocalNames,
    summaries: Summaries,
    runs: HashMap<RunId, u32>,
    hosts: HashMap<HostId, u32>,
    verdicts: HashMap<(u32, u32, u8), u64>,
}

impl BatchBuilder {
    fn new(batch: PreparedBatch) -> Self {
        Self {
            batch,
            names: LocalNames::default(),
            summaries: Summaries::default(),
            runs: HashMap::new(),
            hosts: HashMap::new(),
            verdicts: HashMap::new(),
        }
    }

    fn add(&mut self, mut event: Event) -> Result<(), BatchError> {
        if let Event::Gap(gap) = &mut event {
            gap.count = gap.count.min(MAX_MISSING_EVENTS);
        }
        let EventOrigin { run, reporter } = event.origin();
        if let Some(other) = reporter.filter(|reporter| *reporter != self.batch.head.host) {
            return Err(BatchError::OtherHost(other));
        }
        self.batch.named_runs.extend(run);
        let at = match &event {
            Event::Iteration(iteration) => {
                let start = self.add_iteration(iteration)?;
                self.batch.newest = self.batch.newest.max(Some(start));
                return Ok(());
            }
            Event::RunStarted(run) => run.started,
            Event::RunEnded(end) => end.ended,
            Event::Incident(incident) => incident.at,
            Event::Gap(gap) => {
                self.batch.added.gaps += 1;
                self.batch.added.missing = self.batch.added.missing.saturating_add(gap.count);
                // The count 0 means that the number of missing events is unknown.
                self.batch.added.unknown_gaps += u64::from(gap.count == 0);
                gap.to
            }
            Event::Clock(sample) => sample.at,
        };
        self.batch.newest = self.batch.newest.max(Some(at));
        self.batch.steps.push(Step::Event(Box::new(event)));
        Ok(())
    }

    fn finish(self) -> PreparedBatch {
        let Self { mut batch, names, summaries, verdicts, .. } = self;
        batch.names = names.list;
        batch.summaries = summaries.list;
        batch.verdicts =
            verdicts.into_iter().map(|((run, name, verdict), count)| (run, name, verdict, count)).collect();
        batch.added.nodes = batch.nodes.len() as u64;
        batch
    }
}
