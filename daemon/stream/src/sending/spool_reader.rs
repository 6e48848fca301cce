//! Reading the spool: ahead of the sending, for a comparison, and past a gap.

use peernet_clock::{MonoTime, Span};

use super::Action;
use super::backlog::Backlog;
use super::job::Job;
use super::session::Link;
use crate::Chain;
use crate::spool::{SpooledBatch, Usage};

/// What the batches take that were read without being kept, and the chain of the last.
pub(super) type ScanResult = (Usage, Chain);

/// Batches in the file that are read to be compared and counted, from the first that is not in memory.
#[derive(Clone, Copy, Debug)]
pub(super) struct SpoolScan {
    /// The next.
    at: u64,
    /// The last.
    through: u64,
    usage: Usage,
    /// Chain of the last.
    chain: Option<Chain>,
}

impl SpoolScan {
    pub(super) fn new(at: u64, through: u64) -> Self {
        Self { at, through, usage: Usage::default(), chain: None }
    }

    /// The last batch that is read.
    pub(super) const fn through(&self) -> u64 {
        self.through
    }

    /// What was read; `None` when the last batch was not in the file.
    pub(super) fn result(&self) -> Option<ScanResult> {
        self.chain.map(|chain| (self.usage, chain))
    }

    /// Counts batches that were read from number `from` on; returns whether that was all.
    pub(super) fn count(&mut self, from: u64, batches: &[SpooledBatch]) -> bool {
        if self.at != from {
            return false;
        }
        for batch in batches.iter().filter(|batch| batch.number <= self.through) {
            if batch.number < self.at {
                continue;
            }
            self.usage = self.usage + batch.usage();
            self.chain = (batch.number == self.through).then_some(batch.chain);
            self.at = batch.number + 1;
        }
        if self.at == from {
            // It is missing: the one behind it may be there.
            self.at += 1;
        }
        self.at > self.through
    }
}

/// Batches that the file should hold and does not: somebody deleted them, or the medium failed.
///
/// The one behind them goes with them. Its own chain can no longer be checked by anyone, because that of the batch
/// before it is not known; but it gives the chain before the next one. The stream goes on from there, the hello says
/// so, and the aggregator records what is missing.
#[derive(Clone, Copy, Debug)]
enum SpoolGap {
    /// Its end is searched for here.
    Open(u64),
    /// The first batch behind it that can be sent, and the chain of the one before.
    Ends(u64, Chain),
}

/// Why batches are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LoadPurpose {
    /// To be sent, from this number on.
    Ahead(u64),
    /// To be compared and counted.
    Scan(u64),
    /// To find the end of a gap.
    Probe(u64),
}

/// What is read from the spool, and the gap that was found in it.
#[derive(Clone, Debug, Default)]
pub(super) struct SpoolReader {
    job: Job<LoadPurpose>,
    gap: Option<SpoolGap>,
}

impl SpoolReader {
    /// What is to be read now.
    pub(super) fn next(&mut self, link: &Link, backlog: &Backlog, now: MonoTime) -> Option<Action> {
        if !self.job.is_free(now) {
            return None;
        }
        let part = backlog.part_bytes();
        let (loading, from, bytes) = match (link, self.gap) {
            (Link::Comparing { scan, .. }, _) => (LoadPurpose::Scan(scan.at), scan.at, part),
            (_, Some(SpoolGap::Open(at))) => (LoadPurpose::Probe(at), at, 1),
            (_, Some(SpoolGap::Ends(..))) => return None,
            (Link::Down, None) => return None,
            _ => {
                let from = backlog.unknown();
                backlog.wants_more().then_some((LoadPurpose::Ahead(from), from, part))?
            }
        };
        self.job.begin(loading);
        Some(Action::Load { from, bytes })
    }

    /// When reading may be tried again after a failure.
    pub(super) const fn again(&self) -> Option<MonoTime> {
        self.job.again()
    }

    /// What was asked for was read: why it was; `None` when nothing was asked for.
    pub(super) const fn end(&mut self) -> Option<LoadPurpose> {
        self.job.end()
    }

    /// It could not be read; `None` when nothing was asked for.
    pub(super) fn fail(&mut self, now: MonoTime, pause: Span) -> Option<()> {
        self.job.end()?;
        self.job.fail(now, pause);
        Some(())
    }

    /// The batch after which the file should go on is not in it; the end of the gap is searched for from `at` on.
    pub(super) fn open_gap(&mut self, at: u64, backlog: &Backlog) {
        self.gap = Some(SpoolGap::Open(at));
        self.end_gap_with_file(backlog);
    }

    /// What was found in the search for the end of a gap; whether there is such a search.
    pub(super) fn probed(&mut self, from: u64, batches: &[SpooledBatch], backlog: &Backlog) -> bool {
        if !matches!(self.gap, Some(SpoolGap::Open(at)) if at == from) {
            return false;
        }
        let found = batches.first().filter(|batch| (from..=backlog.spooled()).contains(&batch.number));
        self.gap = Some(match found {
            Some(batch) => SpoolGap::Ends(batch.number + 1, batch.chain),
            None => SpoolGap::Open(from + 1),
        });
        self.end_gap_with_file(backlog);
        true
    }

    /// A gap that nothing is behind ends with what is in the file.
    fn end_gap_with_file(&mut self, backlog: &Backlog) {
        let spooled = backlog.spooled();
        if let Some(SpoolGap::Open(at)) = self.gap
            && at > spooled
            && let Some(chain) = backlog.chain(spooled)
        {
            self.gap = Some(SpoolGap::Ends(spooled + 1, chain));
        }
    }

    /// A gap that was passed, or is found again.
    pub(super) const fn forget_gap(&mut self) {
        self.gap = None;
    }

    /// The first batch behind the gap and the chain before it, once, when everything before the gap is stored over there.
    pub(super) fn pass_gap(&mut self, backlog: &Backlog) -> Option<(u64, Chain)> {
        let Some(SpoolGap::Ends(resume, before)) = self.gap else { return None };
        if backlog.unknown() != backlog.oldest() {
            return None;
        }
        self.gap = None;
        Some((resume, before))
    }
}
