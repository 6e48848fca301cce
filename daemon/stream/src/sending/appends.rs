//! Transactions that append to the spool.

use peernet_clock::{MonoTime, Span};

use super::job::Job;
use crate::Chain;
use crate::spool::SpooledBatch;
use crate::totals::Totals;

/// How often it is written down how much was dropped, while nothing else is written.
const LOSSES_EVERY: Span = Span::from_seconds(1);

/// What was last written to the spool, and the transaction under way.
#[derive(Clone, Debug)]
pub(super) struct Appends {
    job: Job<Appending>,
    /// The totals that were last written.
    written: Totals,
    /// Whether the last attempt failed.
    fails: bool,
    /// Batches were refused: how much was dropped is written down by itself before they are tried again.
    refused: bool,
    /// When something was last to be written.
    begun: MonoTime,
}

/// A transaction under way.
#[derive(Clone, Debug)]
struct Appending {
    last: Option<(u64, Chain)>,
    bytes: u64,
    /// Of those, bytes of batches that were stored over there meanwhile.
    freed: u64,
    /// What is counted up to the last of them, without what [`Totals::with`] adds.
    totals: Totals,
    resolves: bool,
}

/// What a transaction brought into the spool.
#[derive(Clone, Copy, Debug)]
pub(super) struct Appended {
    /// The last batch and its chain; `None` when only the totals were written.
    pub(super) last: Option<(u64, Chain)>,
    pub(super) bytes: u64,
    /// Of those, bytes of batches that were stored over there meanwhile.
    pub(super) freed: u64,
    /// Whether it told the spool what became of the end of an earlier process.
    pub(super) resolves: bool,
}

impl Appends {
    pub(super) fn new(written: Totals) -> Self {
        Self { job: Job::default(), written, fails: false, refused: false, begun: MonoTime::default() }
    }

    /// The totals that were last written.
    pub(super) const fn written(&self) -> &Totals {
        &self.written
    }

    /// Whether the last attempt failed.
    pub(super) const fn fails(&self) -> bool {
        self.fails
    }

    /// Whether batches were refused and nothing was written since.
    pub(super) const fn were_refused(&self) -> bool {
        self.refused
    }

    pub(super) const fn is_under_way(&self) -> bool {
        self.job.is_under_way()
    }

    /// Whether a transaction may begin now.
    pub(super) fn is_free(&mut self, now: MonoTime) -> bool {
        self.job.is_free(now)
    }

    /// When it may be tried again after a failure.
    pub(super) const fn again(&self) -> Option<MonoTime> {
        self.job.again()
    }

    /// The newest batch that is being written; 0 when none is.
    pub(super) fn writing(&mut self) -> u64 {
        self.job.under_way().and_then(|appending| appending.last).map_or(0, |(number, _)| number)
    }

    /// Batches of so many bytes that are being written were stored over there.
    pub(super) fn add_freed(&mut self, bytes: u64) {
        if let Some(appending) = self.job.under_way() {
            appending.freed += bytes;
        }
    }

    /// These are to be written now.
    pub(super) fn begin(&mut self, batches: &[SpooledBatch], totals: &Totals, resolves: bool, now: MonoTime) {
        let last = batches.last().map(|batch| (batch.number, batch.chain));
        let bytes = batches.iter().map(|batch| batch.body.len() as u64).sum();
        (self.begun, self.refused) = (now, false);
        self.job.begin(Appending { last, bytes, freed: 0, totals: totals.clone(), resolves });
    }

    /// They were written; `None` when nothing was to be.
    pub(super) fn end(&mut self) -> Option<Appended> {
        let Appending { last, bytes, freed, totals, resolves } = self.job.end()?;
        let reached = totals.reached.or(self.written.reached);
        self.written = Totals { reached, ..totals };
        Some(Appended { last, bytes, freed, resolves })
    }

    /// Appending works again.
    pub(super) const fn recover(&mut self) {
        self.fails = false;
    }

    /// Nothing was written; `None` when nothing was to be.
    pub(super) fn fail(&mut self, now: MonoTime, pause: Span) -> Option<()> {
        self.refused = self.job.end()?.last.is_some();
        self.job.fail(now, pause);
        self.fails = true;
        Some(())
    }

    /// When to write down that `dropped` events were dropped: a full spool takes no batch that would say so.
    pub(super) fn losses_due(&self, dropped: u64) -> Option<MonoTime> {
        (dropped != self.written.dropped && !self.job.is_under_way()).then(|| self.begun + LOSSES_EVERY)
    }

    /// Whether the file says of everything in it, up to `spooled`, that this process may send it.
    pub(super) fn is_marked(&self, spooled: u64) -> bool {
        self.written.reached.is_some_and(|reached| reached.number >= spooled)
    }
}
