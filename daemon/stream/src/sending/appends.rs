//! Transactions that append to the spool.

use peernet_clock::{MonoTime, Span};

use super::job::Job;
use crate::Chain;
use crate::spool::SpooledBatch;
use crate::totals::Totals;

/// Interval at which the number of dropped events is written while no batch is written.
const LOSS_WRITE_INTERVAL: Span = Span::from_seconds(1);

/// Last state written to the spool, and the transaction in progress.
#[derive(Clone, Debug)]
pub(super) struct Appends {
    job: Job<Appending>,
    /// Totals that were written last.
    written: Totals,
    /// `true` if the last attempt failed.
    fails: bool,
    /// `true` after a failure to write batches: the number of dropped events is then written alone before they are
    /// tried again.
    refused: bool,
    /// Start of the last transaction.
    started_at: MonoTime,
}

/// A transaction in progress.
#[derive(Clone, Debug)]
struct Appending {
    last: Option<(u64, Chain)>,
    bytes: u64,
    /// Number of those bytes whose batches the aggregator stored meanwhile.
    freed: u64,
    /// Totals up to the last batch, without the additions of [`Totals::with`].
    totals: Totals,
    resolves: bool,
}

/// Result of a transaction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Appended {
    /// Last batch and its chain; `None` if only the totals were written.
    pub(super) last: Option<(u64, Chain)>,
    pub(super) bytes: u64,
    /// Number of those bytes whose batches the aggregator stored meanwhile.
    pub(super) freed: u64,
    /// `true` if the transaction recorded the result for an earlier process.
    pub(super) resolves: bool,
}

impl Appends {
    pub(super) fn new(written: Totals) -> Self {
        Self { job: Job::default(), written, fails: false, refused: false, started_at: MonoTime::default() }
    }

    /// Returns the totals that were written last.
    pub(super) const fn written(&self) -> &Totals {
        &self.written
    }

    /// Returns whether the last attempt failed.
    pub(super) const fn fails(&self) -> bool {
        self.fails
    }

    /// Returns whether batches could not be written and nothing was written since.
    pub(super) const fn were_refused(&self) -> bool {
        self.refused
    }

    pub(super) const fn is_in_progress(&self) -> bool {
        self.job.is_in_progress()
    }

    /// Returns whether a transaction may begin now.
    pub(super) fn may_start(&mut self, now: MonoTime) -> bool {
        self.job.may_start(now)
    }

    /// Returns the time of the next attempt after a failure.
    pub(super) const fn retry_at(&self) -> Option<MonoTime> {
        self.job.retry_at()
    }

    /// Returns the number of the newest batch that is being written; 0 if none is.
    pub(super) fn newest_in_progress(&mut self) -> u64 {
        self.job.in_progress_mut().and_then(|appending| appending.last).map_or(0, |(number, _)| number)
    }

    /// Records that the aggregator stored batches which are being written.
    pub(super) fn add_freed(&mut self, bytes: u64) {
        if let Some(appending) = self.job.in_progress_mut() {
            appending.freed += bytes;
        }
    }

    /// Begins a transaction.
    pub(super) fn start(&mut self, batches: &[SpooledBatch], totals: &Totals, resolves: bool, now: MonoTime) {
        let last = batches.last().map(|batch| (batch.number, batch.chain));
        let bytes = batches.iter().map(|batch| batch.body.len() as u64).sum();
        (self.started_at, self.refused) = (now, false);
        self.job.start(Appending { last, bytes, freed: 0, totals: totals.clone(), resolves });
    }

    /// Ends the transaction successfully. Returns its result; `None` if no transaction is in progress.
    pub(super) fn finish(&mut self) -> Option<Appended> {
        let Appending { last, bytes, freed, totals, resolves } = self.job.finish()?;
        // A transaction without this record keeps the record in the file.
        let newest_sent = totals.newest_sent.or(self.written.newest_sent);
        self.written = Totals { newest_sent, ..totals };
        Some(Appended { last, bytes, freed, resolves })
    }

    /// Records that appending works again.
    pub(super) const fn recover(&mut self) {
        self.fails = false;
    }

    /// Ends the transaction as failed; `None` if no transaction is in progress.
    pub(super) fn fail(&mut self, now: MonoTime, pause: Span) -> Option<()> {
        // Only a transaction with batches is followed by one with the counts alone, which needs less space.
        self.refused = self.job.finish()?.last.is_some();
        self.job.fail(now, pause);
        self.fails = true;
        Some(())
    }

    /// Returns the time at which the number of dropped events is written alone. A full spool accepts no batch that
    /// contains it.
    pub(super) fn losses_due(&self, dropped: u64) -> Option<MonoTime> {
        (dropped != self.written.dropped && !self.job.is_in_progress())
            .then(|| self.started_at + LOSS_WRITE_INTERVAL)
    }

    /// Returns whether the file records for all its batches, up to `spooled`, that this process may send them.
    pub(super) fn has_sent_record(&self, spooled: u64) -> bool {
        self.written.newest_sent.is_some_and(|newest_sent| newest_sent.number >= spooled)
    }
}
