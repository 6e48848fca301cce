//! Reading of the spool: ahead of sending, for a comparison, and after a gap.

use peernet_clock::{MonoTime, Span};

use super::Action;
use super::backlog::Backlog;
use super::job::Job;
use super::session::ConnectionState;
use crate::ChainHash;
use crate::spool::{SpooledBatch, Usage};

/// Total size of the scanned batches, which are not kept in memory, and the chain hash of the last scanned batch.
pub(super) type ScanResult = (Usage, ChainHash);

/// Scan of the batches that are in the file only, to compare and count them.
#[derive(Clone, Copy, Debug)]
pub(super) struct SpoolScan {
    /// Number of the next batch.
    next: u64,
    /// Number of the last batch.
    through: u64,
    usage: Usage,
    /// Chain hash of the last batch.
    chain: Option<ChainHash>,
}

impl SpoolScan {
    pub(super) fn new(next: u64, through: u64) -> Self {
        Self { next, through, usage: Usage::default(), chain: None }
    }

    /// Returns the number of the last batch that is read.
    pub(super) const fn through(&self) -> u64 {
        self.through
    }

    /// Returns the result; `None` if the last batch was not in the file.
    pub(super) fn result(&self) -> Option<ScanResult> {
        self.chain.map(|chain| (self.usage, chain))
    }

    /// Counts batches that were read from number `from` on. Returns whether the scan is complete.
    pub(super) fn count(&mut self, from: u64, batches: &[SpooledBatch]) -> bool {
        if self.next != from {
            // The batches are the answer to an earlier read.
            return false;
        }
        for batch in batches.iter().filter(|batch| batch.number <= self.through) {
            if batch.number < self.next {
                continue;
            }
            self.usage = self.usage + batch.usage();
            self.chain = (batch.number == self.through).then_some(batch.chain);
            self.next = batch.number + 1;
        }
        if self.next == from {
            // The batch is missing; the batch after it may exist.
            self.next += 1;
        }
        self.next > self.through
    }
}

/// A gap in the file: batches that should be in the file and are missing, because they were deleted or the medium
/// failed.
///
/// The first batch after the gap is lost, too: its chain hash cannot be verified, because the chain hash of the last
/// missing batch is unknown. Later batches can be verified against the stored chain hash of this first batch. The
/// stream therefore continues with the second batch after the gap. The hello states this batch as the oldest, and the
/// aggregator records the missing batches.
#[derive(Clone, Copy, Debug)]
enum SpoolGap {
    /// The end of the gap is not known yet. The search continues at this number.
    Open(u64),
    /// The end of the gap is known: number of the first batch that can be sent, and the chain hash of the batch before
    /// it.
    Closed(u64, ChainHash),
}

/// Purpose of reading batches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LoadPurpose {
    /// Batches to be sent, from this number on.
    ReadAhead(u64),
    /// Batches to be compared and counted.
    Scan(u64),
    /// Search for the end of a gap.
    GapSearch(u64),
}

/// The requested reading of the spool, and the gap that was found in it.
#[derive(Clone, Debug, Default)]
pub(super) struct SpoolReader {
    job: Job<LoadPurpose>,
    gap: Option<SpoolGap>,
}

impl SpoolReader {
    /// Returns the next read action.
    pub(super) fn next(
        &mut self,
        state: &ConnectionState,
        backlog: &Backlog,
        now: MonoTime,
    ) -> Option<Action> {
        // There is one read at a time, and no read soon after a failure.
        if !self.job.may_start(now) {
            return None;
        }
        let read_bytes = backlog.read_bytes();
        let (purpose, from, bytes) = match (state, self.gap) {
            (ConnectionState::Scanning { scan, .. }, _) => {
                (LoadPurpose::Scan(scan.next), scan.next, read_bytes)
            }
            // The limit is one byte: the search needs the next batch only.
            (_, Some(SpoolGap::Open(at))) => (LoadPurpose::GapSearch(at), at, 1),
            // The batches after the gap are read when `pass_gap` has removed the gap.
            (_, Some(SpoolGap::Closed(..))) => return None,
            // Without a connection, nothing is sent. Reading ahead would have no use.
            (ConnectionState::Down, None) => return None,
            _ => {
                let from = backlog.first_unloaded();
                backlog.should_read_ahead().then_some((LoadPurpose::ReadAhead(from), from, read_bytes))?
            }
        };
        self.job.start(purpose);
        Some(Action::Load { from, bytes })
    }

    /// Returns the time of the next attempt after a failure.
    pub(super) const fn retry_at(&self) -> Option<MonoTime> {
        self.job.retry_at()
    }

    /// Ends the reading successfully. Returns its purpose; `None` if nothing was requested.
    pub(super) const fn finish(&mut self) -> Option<LoadPurpose> {
        self.job.end()
    }

    /// Ends the reading as failed; `None` if nothing was requested.
    pub(super) fn fail(&mut self, now: MonoTime, pause: Span) -> Option<()> {
        self.job.end()?;
        self.job.fail(now, pause);
        Some(())
    }

    /// Records that the next batch is missing from the file. The search for the end of the gap begins at `at`.
    pub(super) fn open_gap(&mut self, at: u64, backlog: &Backlog) {
        self.gap = Some(SpoolGap::Open(at));
        self.end_gap_with_file(backlog);
    }

    /// Handles the result of the search for the end of a gap. Returns whether there is such a search.
    pub(super) fn handle_gap_search(
        &mut self,
        from: u64,
        batches: &[SpooledBatch],
        backlog: &Backlog,
    ) -> bool {
        if !matches!(self.gap, Some(SpoolGap::Open(at)) if at == from) {
            return false;
        }
        let next_batch = batches.first().filter(|batch| (from..=backlog.spooled()).contains(&batch.number));
        self.gap = Some(match next_batch {
            Some(batch) => SpoolGap::Closed(batch.number + 1, batch.chain),
            None => SpoolGap::Open(from + 1),
        });
        self.end_gap_with_file(backlog);
        true
    }

    /// Closes a gap that reaches the end of the file.
    fn end_gap_with_file(&mut self, backlog: &Backlog) {
        let spooled = backlog.spooled();
        if let Some(SpoolGap::Open(at)) = self.gap
            && at > spooled
            && let Some(chain) = backlog.chain(spooled)
        {
            self.gap = Some(SpoolGap::Closed(spooled + 1, chain));
        }
    }

    /// Removes the gap.
    pub(super) const fn forget_gap(&mut self) {
        self.gap = None;
    }

    /// Returns the number of the first batch that can be sent after the gap, and the chain hash before it, when the
    /// aggregator has stored everything before the gap. The gap is then forgotten.
    pub(super) fn pass_gap(&mut self, backlog: &Backlog) -> Option<(u64, ChainHash)> {
        let Some(SpoolGap::Closed(resume, previous_chain)) = self.gap else { return None };
        if backlog.first_unloaded() != backlog.oldest() {
            // Batches before the gap are still in memory and will be stored first.
            return None;
        }
        self.gap = None;
        Some((resume, previous_chain))
    }
}
