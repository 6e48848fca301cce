//! Transactions that append to the spool.

use peernet_clock::{MonoTime, Span};

use super::job::Job;
use crate::ChainHash;
use crate::spool::SpooledBatch;
use crate::totals::Totals;

/// Interval at which the number of dropped events is written while no batch is written.
const LOSS_WRITE_INTERVAL: Span = Span::from_seconds(1);

/// Totals that were last written to the spool, and the transaction in progress.
#[derive(Clone, Debug)]
pub(super) struct Appends {
    job: Job<RunningAppend>,
    /// Totals that were written last.
    written_totals: Totals,
    /// `true` from a failed attempt until [`recover`](Self::recover) is called.
    has_failed: bool,
    /// `true` after a failure to write batches: the number of dropped events is then written alone before the batches
    /// are tried again.
    has_failed_with_batches: bool,
    /// Start of the last transaction.
    started_at: MonoTime,
}

/// A transaction in progress.
#[derive(Clone, Debug)]
struct RunningAppend {
    /// Number and chain hash of the last batch; `None` if only the totals are written.
    last: Option<(u64, ChainHash)>,
    /// Bytes of the written bodies.
    bytes: u64,
    /// Number of written bytes whose batches the aggregator stored meanwhile.
    freed_bytes: u64,
    /// Totals up to the last batch, without the additions of [`Totals::with_resolved`].
    totals: Totals,
    /// `true` if the transaction records which batches of an earlier process are stored.
    resolves_earlier_process: bool,
}

/// Result of a transaction.
#[derive(Clone, Copy, Debug)]
pub(super) struct AppendResult {
    /// Number and chain hash of the last batch; `None` if only the totals were written.
    pub(super) last: Option<(u64, ChainHash)>,
    /// Bytes of the written bodies.
    pub(super) bytes: u64,
    /// Number of written bytes whose batches the aggregator stored meanwhile.
    pub(super) freed_bytes: u64,
    /// `true` if the transaction recorded which batches of an earlier process are stored.
    pub(super) resolves_earlier_process: bool,
}

impl Appends {
    pub(super) fn new(written_totals: Totals) -> Self {
        Self {
            job: Job::default(),
            written_totals,
            has_failed: false,
            has_failed_with_batches: false,
            started_at: MonoTime::default(),
        }
    }

    /// Returns the totals that were written last.
    pub(super) const fn written_totals(&self) -> &Totals {
        &self.written_totals
    }

    /// Returns whether an attempt failed and [`recover`](Self::recover) was not called since then.
    pub(super) const fn has_failed(&self) -> bool {
        self.has_failed
    }

    /// Returns whether batches could not be written and no transaction has begun since then.
    pub(super) const fn has_failed_with_batches(&self) -> bool {
        self.has_failed_with_batches
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

    /// Returns the number of the newest batch that is being written; 0 if no batch is being written.
    pub(super) fn newest_in_progress(&mut self) -> u64 {
        self.job.in_progress_mut().and_then(|appending| appending.last).map_or(0, |(number, _)| number)
    }

    /// Records that the aggregator stored batches that are being written; `bytes` is the length of their bodies.
    pub(super) fn add_freed(&mut self, bytes: u64) {
        if let Some(appending) = self.job.in_progress_mut() {
            appending.freed_bytes += bytes;
        }
    }

    /// Begins a transaction.
    pub(super) fn start(
        &mut self,
        batches: &[SpooledBatch],
        totals: &Totals,
        resolves_earlier_process: bool,
        now: MonoTime,
    ) {
        let last = batches.last().map(|batch| (batch.number, batch.chain));
        let bytes = batches.iter().map(|batch| batch.body.len() as u64).sum();
        (self.started_at, self.has_failed_with_batches) = (now, false);
        self.job.start(RunningAppend {
            last,
            bytes,
            freed_bytes: 0,
            totals: totals.clone(),
            resolves_earlier_process,
        });
    }

    /// Ends the transaction successfully. Returns its result; `None` if no transaction is in progress.
    pub(super) fn finish(&mut self) -> Option<AppendResult> {
        let RunningAppend { last, bytes, freed_bytes, totals, resolves_earlier_process } = self.job.end()?;
        // If the totals do not contain `newest_sendable`, the transaction leaves the record in the file unchanged.
        let newest_sendable = totals.newest_sendable.or(self.written_totals.newest_sendable);
        self.written_totals = Totals { newest_sendable, ..totals };
        Some(AppendResult { last, bytes, freed_bytes, resolves_earlier_process })
    }

    /// Records that appending works again.
    pub(super) const fn recover(&mut self) {
        self.has_failed = false;
    }

    /// Ends the transaction as failed; `None` if no transaction is in progress.
    pub(super) fn fail(&mut self, now: MonoTime, pause: Span) -> Option<()> {
        // After a transaction with batches failed, a transaction with the counts alone is tried. It needs less space.
        self.has_failed_with_batches = self.job.end()?.last.is_some();
        self.job.fail(now, pause);
        self.has_failed = true;
        Some(())
    }

    /// Returns the time at which the number of dropped events is written without batches, because a full spool accepts
    /// no batch.
    pub(super) fn losses_due_at(&self, dropped: u64) -> Option<MonoTime> {
        (dropped != self.written_totals.dropped && !self.job.is_in_progress())
            .then(|| self.started_at + LOSS_WRITE_INTERVAL)
    }

    /// Returns whether the file contains the record that this process is allowed to send all batches up to number
    /// `through`.
    pub(super) fn has_recorded_sendable(&self, through: u64) -> bool {
        self.written_totals.newest_sendable.is_some_and(|newest_sendable| newest_sendable.number >= through)
    }
}
