//! The backlog of numbered batches: which batches are in memory and which are in the spool, and their sizes.

mod pending_batches;
mod ready_batches;
mod sent_batches;
mod stream_origin;

use bytes::Bytes;
use peernet_clock::WallTime;

use self::pending_batches::PendingBatches;
use self::ready_batches::ReadyBatches;
use self::sent_batches::SentBatches;
use self::stream_origin::StreamOrigin;
use super::intake::UnnumberedBatch;
use super::spool_reader::{ScanResult, SpoolScan};
use crate::spool::{SpoolState, SpooledBatch, Usage};
use crate::totals::Totals;
use crate::{BatchHead, ChainHash, SentUnspooled, StreamId, SubmittedEvents};
use peernet_logger::HostId;

/// Batches from the oldest batch without an acknowledgement to the newest batch.
///
/// ```text
///   oldest .. loaded        ..        spooled        ..        newest
///   ready: spooled and      in the file only         pending: in memory
///   in memory                                        only
/// ```
///
/// Each of the three ranges may be empty. Batches that were sent and not acknowledged are always in memory.
#[derive(Clone, Debug)]
pub(super) struct Backlog {
    pub(super) origin: StreamOrigin,
    oldest: OldestBatch,
    ready: ReadyBatches,
    /// Number and chain hash of the newest batch in the file.
    spooled: (u64, ChainHash),
    pending: PendingBatches,
    /// Totals up to the newest batch that is in the file or stored by the aggregator.
    settled: Totals,
    /// Number and chain hash of the newest batch.
    newest: (u64, ChainHash),
    waiting_usage: Usage,
    sent: SentBatches,
    /// Number of events that the aggregator stored.
    stored_events: u64,
}

/// Oldest unacknowledged batch; if there is none, `number` is the number after the newest batch.
#[derive(Clone, Copy, Debug)]
struct OldestBatch {
    number: u64,
    /// Chain hash of the batch before the oldest.
    previous_chain: ChainHash,
    /// Time of the first event of the oldest batch, if it is in the file only. After an acknowledgement, this is the
    /// time of the last stored batch, until the oldest batch is read.
    since: Option<WallTime>,
}

/// Batches that an acknowledgement freed.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FreedBatches {
    pub(super) events: u64,
    /// Bytes of the freed batches that were in the file.
    pub(super) spooled_bytes: u64,
    /// Bytes of the freed batches that were being written to the file.
    pub(super) writing_bytes: u64,
}

impl Backlog {
    /// Continues from the content of the spool; `budget` bytes of batches are kept in memory for sending.
    pub(super) fn new(spool: &SpoolState, budget: u64) -> Self {
        let oldest = spool.oldest.max(1);
        // A spool without batches continues the numbers after the last batch that it held.
        let newest =
            if spool.newest.0 >= oldest { spool.newest } else { (oldest - 1, spool.chain_before_oldest) };
        // Without batches, no event waits, even if the spool's count of waiting events is not zero.
        let waiting_usage = if newest.0 < oldest { Usage::default() } else { spool.waiting_usage };
        let Totals { produced, dropped, .. } = spool.totals;
        // `submitted` counts events of the current process, which has submitted nothing yet.
        let settled = Totals { submitted: SubmittedEvents::default(), ..spool.totals.clone() };
        Self {
            origin: StreamOrigin::new(spool),
            oldest: OldestBatch {
                number: oldest,
                previous_chain: spool.chain_before_oldest,
                since: spool.since,
            },
            ready: ReadyBatches::new(budget),
            spooled: newest,
            pending: PendingBatches::default(),
            settled,
            newest,
            waiting_usage,
            sent: SentBatches::default(),
            stored_events: produced.saturating_sub(dropped.saturating_add(waiting_usage.events)),
        }
    }

    /// Adds a batch with the next number.
    pub(super) fn push(&mut self, batch: UnnumberedBatch) {
        let UnnumberedBatch { since, events, body, totals } = batch;
        let chain = self.newest.1.next(events, &body);
        self.newest = (self.newest.0 + 1, chain);
        let batch = SpooledBatch { number: self.newest.0, since, events, chain, body };
        self.waiting_usage = self.waiting_usage + batch.usage();
        self.pending.push(batch, totals);
    }

    pub(super) const fn oldest(&self) -> u64 {
        self.oldest.number
    }

    /// Returns the number and the chain hash of the batch before the oldest batch.
    pub(super) const fn acknowledged(&self) -> (u64, ChainHash) {
        (self.oldest.number - 1, self.oldest.previous_chain)
    }

    pub(super) const fn newest(&self) -> u64 {
        self.newest.0
    }

    pub(super) const fn spooled(&self) -> u64 {
        self.spooled.0
    }

    /// Returns the number of the newest batch that this process has sent.
    pub(super) const fn newest_sent(&self) -> u64 {
        self.sent.newest()
    }

    pub(super) const fn sent_events(&self) -> u64 {
        self.sent.events()
    }

    pub(super) const fn sent_unspooled(&self) -> Option<SentUnspooled> {
        self.sent.unspooled()
    }

    /// Returns the number of events that the aggregator stored.
    pub(super) const fn stored_events(&self) -> u64 {
        self.stored_events
    }

    /// Adds events that the aggregator stored although the spool does not contain them.
    pub(super) const fn add_stored(&mut self, events: u64) {
        self.stored_events += events;
    }

    pub(super) const fn waiting_usage(&self) -> Usage {
        self.waiting_usage
    }

    pub(super) const fn pending_usage(&self) -> Usage {
        self.pending.usage()
    }

    /// Returns the totals up to the newest batch that is in the file or stored by the aggregator.
    pub(super) const fn settled_totals(&self) -> &Totals {
        &self.settled
    }

    /// Drops the batches that are in memory only. Returns the number of their events.
    pub(super) fn give_up(&mut self) -> u64 {
        let lost = self.pending.usage();
        while let Some(pending) = self.pending.pop_through(u64::MAX) {
            self.sent.forget(&pending.batch);
        }
        self.waiting_usage = self.waiting_usage - lost;
        lost.events
    }

    /// Returns the size of the batches that are in the file only.
    pub(super) fn file_only_usage(&self) -> Usage {
        self.waiting_usage - self.ready.usage() - self.pending.usage()
    }

    /// Returns the time of the oldest batch's first event.
    pub(super) fn since(&self) -> Option<WallTime> {
        match self.ready.front().or(self.pending.front()) {
            Some(batch) if batch.number == self.oldest.number => Some(batch.since),
            _ => self.oldest.since,
        }
    }

    /// Returns the number of the first batch that is not in memory; beyond `spooled` if the file holds no such batch.
    pub(super) fn first_unloaded(&self) -> u64 {
        self.oldest.number + self.ready.len() as u64
    }

    /// Returns the number of bytes of one read from the file.
    pub(super) fn read_bytes(&self) -> usize {
        usize::try_from(self.ready.read_bytes()).unwrap_or(usize::MAX)
    }

    /// Returns whether the next batches should be read from the file, from [`first_unloaded`](Self::first_unloaded) on.
    pub(super) fn should_read_ahead(&self) -> bool {
        self.first_unloaded() <= self.spooled.0 && self.ready.has_capacity(self.ready.read_bytes())
    }

    /// Returns the batches for the spool's next transaction, with a limit on their number and bytes, and the totals up
    /// to the last of these batches.
    pub(super) fn next_append(
        &self,
        max_batches: usize,
        max_bytes: u64,
    ) -> Option<(Vec<SpooledBatch>, Totals)> {
        self.pending.next_append(max_batches, max_bytes)
    }

    /// Records that batches up to `through`, which has the chain hash `chain`, are in the file.
    pub(super) fn mark_appended(&mut self, through: u64, chain: ChainHash) {
        self.advance_file(through, chain);
        while let Some(pending) = self.pending.pop_through(through) {
            let (usage, batch) = (pending.batch.usage(), pending.batch);
            self.settled = pending.totals;
            // Batches in flight stay in memory, because they may have to be sent again at once.
            let should_stay = self.ready.has_capacity(usage.bytes) || batch.number <= self.sent.newest();
            // Ready batches are contiguous: if the previous batch is in the file only, this batch is read from the file
            // later.
            if batch.number == self.first_unloaded() && should_stay {
                self.ready.push(batch);
            }
        }
    }

    /// Records that the newest number of the file is at least `through`. The file does not contain that batch if the
    /// batch was sent from memory and a deletion recorded its number (`Action::Delete`).
    pub(super) fn advance_file(&mut self, through: u64, chain: ChainHash) {
        // Results of writes may arrive after an acknowledgement has advanced the file further.
        if through > self.spooled.0 {
            self.spooled = (through, chain);
        }
    }

    /// Adds batches read from the file. Batches that do not continue the ready batches are ignored. Returns the number
    /// of added batches.
    pub(super) fn add_loaded(&mut self, batches: Vec<SpooledBatch>) -> usize {
        let previous_len = self.ready.len();
        for batch in batches {
            // The read was started earlier; meanwhile batches may have been acknowledged or kept in memory.
            if batch.number == self.first_unloaded() && batch.number <= self.spooled.0 {
                self.ready.push(batch);
            }
        }
        self.ready.len() - previous_len
    }

    /// Returns a batch that is in memory. Without `include_unspooled`, the result is `None` for a batch that is not in
    /// the file.
    pub(super) fn get(&self, number: u64, include_unspooled: bool) -> Option<&SpooledBatch> {
        let index = number.checked_sub(self.oldest.number)?;
        let pending = || self.pending.get(number).filter(|_| include_unspooled).map(|pending| &pending.batch);
        self.ready.get(index as usize).or_else(pending)
    }

    /// Returns the chain hash of a batch if it is known without reading the file.
    pub(super) fn chain(&self, number: u64) -> Option<ChainHash> {
        match number {
            _ if number == self.oldest.number - 1 => Some(self.oldest.previous_chain),
            _ if number == self.spooled.0 && number >= self.oldest.number => Some(self.spooled.1),
            _ => {
                let include_unspooled = true;
                self.get(number, include_unspooled).map(|batch| batch.chain)
            }
        }
    }

    /// Returns the head and the body of a batch to be sent, and records it as sent.
    pub(super) fn send(
        &mut self,
        number: u64,
        include_unspooled: bool,
        (host, process): (HostId, u64),
    ) -> Option<(BatchHead, Bytes)> {
        let previous_chain = self.chain(number.checked_sub(1)?)?;
        let batch = self.get(number, include_unspooled)?;
        let (chain, events, body) = (batch.chain, batch.events, batch.body.clone());
        // Counts are recorded for batches that are not in the file. If this process is killed, the next process needs
        // these counts to know which events are stored.
        let unspooled = self.pending.get(number).filter(|_| number > self.spooled.0).map(|pending| {
            let Totals { produced, dropped, reported_drops, submitted, .. } = &pending.totals;
            let (batched, events) = (submitted.batched.total, produced - dropped);
            SentUnspooled { process, number, batched, reported_drops: *reported_drops, events }
        });
        self.sent.record(number, events, unspooled);
        let head = BatchHead {
            host,
            stream: self.origin.stream,
            process,
            number,
            previous_chain,
            chain,
            events,
            events_before: self.stored_events + self.events_before(number),
        };
        Some((head, body))
    }

    /// Returns the number of events in the unacknowledged batches before batch `number`. These batches must be in
    /// memory.
    fn events_before(&self, number: u64) -> u64 {
        let earlier = self.ready.iter().chain(self.pending.iter()).take_while(|batch| batch.number < number);
        earlier.map(|batch| u64::from(batch.events)).sum()
    }

    /// Frees the batches up to `through`, which the aggregator stored. If some of these batches are in the file only,
    /// `scanned` contains the total size of those batches and the chain hash of the last of them.
    ///
    /// Batches up to `writing` are being written to the file.
    pub(super) fn free(&mut self, through: u64, scanned: Option<ScanResult>, writing: u64) -> FreedBatches {
        let mut freed = FreedBatches::default();
        while let Some(batch) = self.ready.pop_through(through) {
            self.waiting_usage = self.waiting_usage - batch.usage();
            freed.spooled_bytes += batch.usage().bytes;
            self.forget(&batch, &mut freed);
        }
        if let Some((usage, chain)) = scanned {
            self.waiting_usage = self.waiting_usage - usage;
            freed.events += usage.events;
            freed.spooled_bytes += usage.bytes;
            self.oldest =
                OldestBatch { number: through.min(self.spooled.0) + 1, previous_chain: chain, since: None };
        }
        while let Some(pending) = self.pending.pop_through(through) {
            self.waiting_usage = self.waiting_usage - pending.batch.usage();
            self.settled = pending.totals;
            if pending.batch.number <= writing {
                freed.writing_bytes += pending.batch.usage().bytes;
            }
            self.forget(&pending.batch, &mut freed);
        }
        self.stored_events += freed.events;
        freed
    }

    /// Makes the batch after a stored batch the oldest batch, and counts the events of the stored batch.
    fn forget(&mut self, batch: &SpooledBatch, freed: &mut FreedBatches) {
        freed.events += u64::from(batch.events);
        self.sent.forget(batch);
        self.oldest =
            OldestBatch { number: batch.number + 1, previous_chain: batch.chain, since: Some(batch.since) };
    }

    /// Returns the chain hash of a batch, and the scan result for the batches up to it that are in the file only;
    /// `None` if the file must be read first.
    pub(super) fn find_in_memory(&self, number: u64) -> Option<(ChainHash, Option<ScanResult>)> {
        let chain = self.chain(number)?;
        if number < self.first_unloaded() || self.first_unloaded() > self.spooled.0 {
            return Some((chain, None));
        }
        // Without reading, the total size of the batches that are in the file only is known, but not the size of some
        // of them.
        let usage = (number >= self.spooled.0).then(|| self.file_only_usage());
        let last_chain = self.chain(self.spooled.0)?;
        Some((chain, Some((usage?, last_chain))))
    }

    /// Returns the scan of the file that finds a batch which [`find_in_memory`](Self::find_in_memory) does not find.
    pub(super) fn scan_to(&self, number: u64) -> SpoolScan {
        SpoolScan::new(self.first_unloaded(), number.min(self.spooled.0))
    }

    /// Skips the batches before batch `resume`, which no longer exist. No skipped batch is in memory. `previous_chain`
    /// is the chain hash of the last skipped batch.
    pub(super) fn skip_to(&mut self, resume: u64, previous_chain: ChainHash) {
        self.oldest = OldestBatch { number: resume, previous_chain, since: None };
    }

    /// Removes the batches that should be in the file and are missing. Returns their size. While other batches are in
    /// the file only, the missing batches are not known yet and the result is zero.
    pub(super) fn remove_missing(&mut self) -> Usage {
        if self.first_unloaded() <= self.spooled.0 {
            return Usage::default();
        }
        let missing = self.file_only_usage();
        self.waiting_usage = self.waiting_usage - missing;
        missing
    }

    /// Continues the unacknowledged batches in a new stream.
    pub(super) const fn renew(&mut self, stream: StreamId) {
        self.origin = self.origin.renewed(stream, self.oldest.number, self.stored_events);
    }
}
