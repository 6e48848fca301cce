//! Batches made ready to be inserted: all that needs no database is done beside the writer and not by it.
//!
//! Runs, names and hosts stand as positions in lists of the batch's own; the writer knows their numbers.

mod iteration;
mod names;
mod rows;
mod summaries;

use std::collections::{BTreeSet, HashMap, HashSet};

use bytes::Bytes;
use peernet_clock::WallTime;
use peernet_logger::{HostId, RunId};
use peernet_stream::codec::{self, CodecError};
use peernet_stream::{BatchHead, Claim, Event, OutcomeCounts};

use self::names::LocalNames;
pub(super) use self::names::NameKey;
pub(super) use self::rows::{AnchorRow, IterationRow, NodeRow, TransitRow};
use self::summaries::Summaries;
pub(super) use self::summaries::SummaryPart;
use crate::extent::Extent;
use crate::stored::Stored;

pub(super) use self::iteration::position;

/// Most events that a gap may say are missing: a host may claim any number, and no sum in the database may overflow.
const MOST_MISSING: u64 = 1 << 40;

/// A batch ready to be inserted.
#[derive(Debug)]
pub struct Prepared {
    pub(super) head: BatchHead,
    /// The events as they came, for the quarantine.
    pub(super) body: Bytes,
    /// What is written one by one, in the order in which it happened.
    pub(super) steps: Vec<Step>,
    pub(super) runs: Vec<RunPart>,
    /// Every run that an event of it names, of whatever kind.
    pub(super) claimed: BTreeSet<RunId>,
    pub(super) names: Vec<NameKey>,
    /// Hosts in trees beside the edge.
    pub(super) hosts: Vec<HostId>,
    pub(super) iterations: Vec<IterationRow>,
    pub(super) nodes: Vec<NodeRow>,
    pub(super) anchors: Vec<AnchorRow>,
    pub(super) transits: Vec<TransitRow>,
    pub(super) summaries: Vec<SummaryPart>,
    /// How often each verdict was given: run, name, verdict, count.
    pub(super) verdicts: Vec<(u32, u32, u8, u64)>,
    /// What it adds to the counters of its host.
    pub(super) added: Stored,
    /// The newest moment in it, on its host's clock.
    pub(super) newest: Option<WallTime>,
}

/// Something that the writer does before the rows of iterations are inserted.
#[derive(Debug)]
pub(super) enum Step {
    /// An event that is no iteration.
    Event(Box<Event>),
    /// Iterations of this run follow, the first of which began then.
    Run(u32, WallTime),
}

/// A run of which the batch has iterations, and what it adds to its counters.
#[derive(Debug)]
pub(super) struct RunPart {
    pub(super) id: RunId,
    pub(super) outcomes: OutcomeCounts,
    pub(super) warm_up: u64,
    /// Starts that were skipped before them, without those before the warm-up.
    pub(super) skipped_starts: u64,
    /// When the last of them began.
    pub(super) last: WallTime,
    pub(super) numbers: Extent,
    /// The seconds in which they began.
    pub(super) seconds: Extent,
}

/// The reason why a batch can never be stored, whatever the database holds.
#[derive(Debug, thiserror::Error)]
pub(crate) enum BatchError {
    /// Its events cannot be read.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// The database has no such numbers.
    #[error("iteration number {0} is too large")]
    IterationNumber(u64),
    /// The tree of an iteration is empty.
    #[error("iteration {0} has no host")]
    NoHost(i64),
    /// An event is about something that another host measured.
    #[error("an event was measured on another host, {0}")]
    OtherHost(HostId),
}

impl Prepared {
    /// Makes rows and statistics of the events of a batch.
    ///
    /// # Errors
    /// When they cannot be read or cannot be stored.
    pub(crate) fn new(head: BatchHead, body: Bytes) -> Result<Self, BatchError> {
        Self::without(head, body, &HashSet::new())
    }

    /// The same, some iterations left out: those are stored already.
    pub(super) fn without(
        head: BatchHead,
        body: Bytes,
        stored: &HashSet<(RunId, i64)>,
    ) -> Result<Self, BatchError> {
        let events = codec::events(&body, head.events)?;
        let mut preparing = Preparing::of(Self::empty(head, body));
        for event in events {
            if let (false, Event::Iteration(it)) = (stored.is_empty(), &event)
                && stored.contains(&(it.run, it.number.cast_signed()))
            {
                preparing.batch.added.events -= 1;
                continue;
            }
            preparing.add(event)?;
        }
        Ok(preparing.done())
    }

    /// What it counts when commits are cut by nodes.
    pub(crate) fn weight(&self) -> usize {
        1 + self.steps.len() + self.nodes.len()
    }

    fn empty(head: BatchHead, body: Bytes) -> Self {
        Self {
            head,
            body,
            steps: Vec::new(),
            runs: Vec::new(),
            claimed: BTreeSet::new(),
            names: Vec::new(),
            hosts: Vec::new(),
            iterations: Vec::new(),
            nodes: Vec::new(),
            anchors: Vec::new(),
            transits: Vec::new(),
            summaries: Vec::new(),
            verdicts: Vec::new(),
            added: Stored { events: u64::from(head.events), ..Stored::default() },
            newest: None,
        }
    }
}

/// A batch under preparation, and what is needed to find things in it.
#[derive(Debug)]
struct Preparing {
    batch: Prepared,
    names: LocalNames,
    summaries: Summaries,
    runs: HashMap<RunId, u32>,
    hosts: HashMap<HostId, u32>,
    verdicts: HashMap<(u32, u32, u8), u64>,
}

impl Preparing {
    fn of(batch: Prepared) -> Self {
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
            gap.count = gap.count.min(MOST_MISSING);
        }
        let Claim { run, reporter } = event.claim();
        if let Some(other) = reporter.filter(|reporter| *reporter != self.batch.head.host) {
            return Err(BatchError::OtherHost(other));
        }
        self.batch.claimed.extend(run);
        let at = match &event {
            Event::Iteration(iteration) => {
                let began = self.iteration(iteration)?;
                self.batch.newest = self.batch.newest.max(Some(began));
                return Ok(());
            }
            Event::RunStarted(run) => run.started,
            Event::RunEnded(end) => end.ended,
            Event::Incident(incident) => incident.at,
            Event::Gap(gap) => {
                self.batch.added.gaps += 1;
                self.batch.added.missing = self.batch.added.missing.saturating_add(gap.count);
                gap.to
            }
            Event::Clock(sample) => sample.at,
        };
        self.batch.newest = self.batch.newest.max(Some(at));
        self.batch.steps.push(Step::Event(Box::new(event)));
        Ok(())
    }

    fn done(self) -> Prepared {
        let Self { mut batch, names, summaries, verdicts, .. } = self;
        batch.names = names.list;
        batch.summaries = summaries.list;
        batch.verdicts =
            verdicts.into_iter().map(|((run, name, verdict), count)| (run, name, verdict, count)).collect();
        batch.added.nodes = batch.nodes.len() as u64;
        batch
    }
}
