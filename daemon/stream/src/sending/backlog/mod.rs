//! The numbered batches: which there are, where each of them is, and what they take.

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
use super::intake::CutBatch;
use super::spool_reader::{ScanResult, SpoolScan};
use crate::spool::{SpoolState, SpooledBatch, Usage};
use crate::totals::Totals;
use crate::{BatchHead, Chain, HandedIn, SentUnspooled, StreamId};
use peernet_logger::HostId;

/// Batches from the oldest that is not acknowledged to the newest.
///
/// ```text
///   oldest .. loaded        ..        spooled        ..        newest
///   ready: spooled and      in the file only         pending: in memory
///   in memory                                        only
/// ```
///
/// Any of the three parts may be empty. What was sent and not acknowledged is always in memory.
#[derive(Clone, Debug)]
pub(super) struct Backlog {
    pub(super) origin: StreamOrigin,
    oldest: OldestBatch,
    ready: ReadyBatches,
    /// The newest that is in the file, and its chain.
    spooled: (u64, Chain),
    pending: PendingBatches,
    /// What was counted up to the newest that is in the file or stored over there.
    settled: Totals,
    newest: (u64, Chain),
    held: Usage,
    sent: SentBatches,
    /// Events that are stored over there.
    stored: u64,
}

/// The oldest batch that is held; one behind the newest when none is.
#[derive(Clone, Copy, Debug)]
struct OldestBatch {
    number: u64,
    /// Chain of the one before it.
    before: Chain,
    /// When its first event came, while it is in the file only.
    since: Option<WallTime>,
}

/// What an acknowledgement freed.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FreedBatches {
    pub(super) events: u64,
    /// Bytes of those that were in the file.
    pub(super) spooled_bytes: u64,
    /// Bytes of those that were being written to it.
    pub(super) writing_bytes: u64,
}

impl Backlog {
    pub(super) fn new(spool: &SpoolState, budget: u64) -> Self {
        let oldest = spool.oldest.max(1);
        let newest = if spool.newest.0 >= oldest { spool.newest } else { (oldest - 1, spool.before) };
        let held = if newest.0 < oldest { Usage::default() } else { spool.held };
        let Totals { produced, dropped, .. } = spool.totals;
        Self {
            origin: StreamOrigin::new(spool),
            oldest: OldestBatch { number: oldest, before: spool.before, since: spool.since },
            ready: ReadyBatches::new(budget),
            spooled: newest,
            pending: PendingBatches::default(),
            settled: Totals { handed_in: HandedIn::default(), ..spool.totals.clone() },
            newest,
            held,
            sent: SentBatches::default(),
            stored: produced.saturating_sub(dropped.saturating_add(held.events)),
        }
    }

    /// Numbers a batch.
    pub(super) fn push(&mut self, cut: CutBatch) {
        let CutBatch { since, events, body, totals } = cut;
        let chain = self.newest.1.then(events, &body);
        self.newest = (self.newest.0 + 1, chain);
        let batch = SpooledBatch { number: self.newest.0, since, events, chain, body };
        self.held = self.held + batch.usage();
        self.pending.push(batch, totals);
    }

    pub(super) const fn oldest(&self) -> u64 {
        self.oldest.number
    }

    /// The one before the oldest and its chain.
    pub(super) const fn acknowledged(&self) -> (u64, Chain) {
        (self.oldest.number - 1, self.oldest.before)
    }

    pub(super) const fn newest(&self) -> u64 {
        self.newest.0
    }

    pub(super) const fn spooled(&self) -> u64 {
        self.spooled.0
    }

    /// The newest that was ever sent by this process.
    pub(super) const fn sent(&self) -> u64 {
        self.sent.newest()
    }

    pub(super) const fn sent_events(&self) -> u64 {
        self.sent.events()
    }

    pub(super) const fn sent_unspooled(&self) -> Option<SentUnspooled> {
        self.sent.unspooled()
    }

    /// Events that are stored over there.
    pub(super) const fn stored(&self) -> u64 {
        self.stored
    }

    /// More events turned out to be stored than the spool says.
    pub(super) const fn add_stored(&mut self, events: u64) {
        self.stored += events;
    }

    pub(super) const fn held(&self) -> Usage {
        self.held
    }

    pub(super) const fn pending(&self) -> Usage {
        self.pending.usage()
    }

    /// What was counted up to the newest that is in the file or stored over there.
    pub(super) const fn settled(&self) -> &Totals {
        &self.settled
    }

    /// What is in memory only is lost. Returns how many events that are.
    pub(super) fn give_up(&mut self) -> u64 {
        let lost = self.pending.usage();
        while let Some(pending) = self.pending.pop_through(u64::MAX) {
            self.sent.forget(&pending.batch);
        }
        self.held = self.held - lost;
        lost.events
    }

    /// What is in the file only.
    pub(super) fn filed(&self) -> Usage {
        self.held - self.ready.usage() - self.pending.usage()
    }

    /// When the first event of the oldest batch came.
    pub(super) fn since(&self) -> Option<WallTime> {
        match self.ready.front().or(self.pending.front()) {
            Some(batch) if batch.number == self.oldest.number => Some(batch.since),
            _ => self.oldest.since,
        }
    }

    /// The first that is not known in memory; beyond `spooled` when the file holds no other.
    pub(super) fn unknown(&self) -> u64 {
        self.oldest.number + self.ready.len() as u64
    }

    /// Bytes that are read at once.
    pub(super) fn part_bytes(&self) -> usize {
        usize::try_from(self.ready.part_bytes()).unwrap_or(usize::MAX)
    }

    /// Whether the next part is to be read from the file, beginning with [`unknown`](Self::unknown).
    pub(super) fn wants_more(&self) -> bool {
        self.unknown() <= self.spooled.0 && self.ready.has_room(self.ready.part_bytes())
    }

    /// What the next transaction of the spool is to hold: the pending batches up to so many bytes, and what was
    /// counted up to the last of them.
    pub(super) fn to_append(&self, most: usize, most_bytes: u64) -> Option<(Vec<SpooledBatch>, Totals)> {
        self.pending.to_append(most, most_bytes)
    }

    /// Batches up to and including this one, with this chain, are in the file. Returns the bytes of those that are
    /// held.
    pub(super) fn appended(&mut self, through: u64, chain: Chain) -> u64 {
        let mut bytes = 0;
        self.passed(through, chain);
        while let Some(pending) = self.pending.pop_through(through) {
            let (usage, batch) = (pending.batch.usage(), pending.batch);
            self.settled = pending.totals;
            bytes += usage.bytes;
            let is_wanted = self.ready.has_room(usage.bytes) || batch.number <= self.sent.newest();
            if batch.number == self.unknown() && is_wanted {
                self.ready.push(batch);
            }
        }
        bytes
    }

    /// The file has come to this one, with it or without it.
    pub(super) fn passed(&mut self, through: u64, chain: Chain) {
        if through > self.spooled.0 {
            self.spooled = (through, chain);
        }
    }

    /// Batches read from the file; those that do not follow what is known are left out. Returns how many were taken.
    pub(super) fn loaded(&mut self, batches: Vec<SpooledBatch>) -> usize {
        let known = self.ready.len();
        for batch in batches {
            if batch.number == self.unknown() && batch.number <= self.spooled.0 {
                self.ready.push(batch);
            }
        }
        self.ready.len() - known
    }

    /// The frame's parts of a batch that is in memory, the spooled ones only or all.
    pub(super) fn get(&self, number: u64, unspooled: bool) -> Option<&SpooledBatch> {
        let index = number.checked_sub(self.oldest.number)?;
        let pending = || self.pending.get(number).filter(|_| unspooled).map(|pending| &pending.batch);
        self.ready.get(index as usize).or_else(pending)
    }

    /// The chain of a batch where it is known without the file.
    pub(super) fn chain(&self, number: u64) -> Option<Chain> {
        match number {
            _ if number == self.oldest.number - 1 => Some(self.oldest.before),
            _ if number == self.spooled.0 && number >= self.oldest.number => Some(self.spooled.1),
            _ => self.get(number, true).map(|batch| batch.chain),
        }
    }

    /// The head and body of a batch to be sent; it counts as sent.
    pub(super) fn send(
        &mut self,
        number: u64,
        unspooled: bool,
        (host, process): (HostId, u64),
    ) -> Option<(BatchHead, Bytes)> {
        let before = self.chain(number.checked_sub(1)?)?;
        let batch = self.get(number, unspooled)?;
        let (chain, events, body) = (batch.chain, batch.events, batch.body.clone());
        let unspooled = self.pending.get(number).filter(|_| number > self.spooled.0).map(|pending| {
            let Totals { produced, dropped, told, handed_in, .. } = &pending.totals;
            let (taken, events) = (handed_in.taken.all, produced - dropped);
            SentUnspooled { process, number, taken, told: *told, events }
        });
        self.sent.record(number, events, unspooled);
        let head = BatchHead {
            host,
            stream: self.origin.stream,
            process,
            number,
            before,
            chain,
            events,
            events_before: self.stored + self.events_before(number),
        };
        Some((head, body))
    }

    /// How many events the batches hold from the oldest to the one before this, all of which are in memory.
    fn events_before(&self, number: u64) -> u64 {
        let before = self.ready.iter().chain(self.pending.iter()).take_while(|batch| batch.number < number);
        before.map(|batch| u64::from(batch.events)).sum()
    }

    /// Batches up to and including `through` are stored over there: they are all in memory, or `scanned` says what the
    /// ones in the file only take and the chain of the last of them.
    ///
    /// Batches up to and including `writing` are being written to the file.
    pub(super) fn free(&mut self, through: u64, scanned: Option<ScanResult>, writing: u64) -> FreedBatches {
        let mut freed = FreedBatches::default();
        while let Some(batch) = self.ready.pop_through(through) {
            self.held = self.held - batch.usage();
            freed.spooled_bytes += batch.usage().bytes;
            self.forget(&batch, &mut freed);
        }
        if let Some((usage, chain)) = scanned {
            self.held = self.held - usage;
            freed.events += usage.events;
            freed.spooled_bytes += usage.bytes;
            self.oldest = OldestBatch { number: through.min(self.spooled.0) + 1, before: chain, since: None };
        }
        while let Some(pending) = self.pending.pop_through(through) {
            self.held = self.held - pending.batch.usage();
            self.settled = pending.totals;
            if pending.batch.number <= writing {
                freed.writing_bytes += pending.batch.usage().bytes;
            }
            self.forget(&pending.batch, &mut freed);
        }
        self.stored += freed.events;
        freed
    }

    fn forget(&mut self, batch: &SpooledBatch, freed: &mut FreedBatches) {
        freed.events += u64::from(batch.events);
        self.sent.forget(batch);
        (self.oldest.number, self.oldest.before) = (batch.number + 1, batch.chain);
    }

    /// The chain of a batch and what the batches up to it take that are in the file only; `None` when the file must be
    /// asked.
    pub(super) fn known(&self, number: u64) -> Option<(Chain, Option<ScanResult>)> {
        let chain = self.chain(number)?;
        if number < self.unknown() || self.unknown() > self.spooled.0 {
            return Some((chain, None));
        }
        let all = (number >= self.spooled.0).then(|| self.filed());
        let last = self.chain(self.spooled.0)?;
        Some((chain, Some((all?, last))))
    }

    /// What is to be read for [`known`](Self::known) to be answered; nothing when it is.
    pub(super) fn scan_to(&self, number: u64) -> SpoolScan {
        SpoolScan::new(self.unknown(), number.min(self.spooled.0))
    }

    /// The oldest batches up to the one before `resume` do not exist any more; none of them is in memory. `before` is
    /// the chain of the last of them.
    pub(super) fn skip_to(&mut self, resume: u64, before: Chain) {
        self.oldest = OldestBatch { number: resume, before, since: None };
    }

    /// What is said to be in the file and is not: known when nothing else is in the file only. It no longer counts as
    /// held.
    pub(super) fn settle(&mut self) -> Usage {
        if self.unknown() <= self.spooled.0 {
            return Usage::default();
        }
        let missing = self.filed();
        self.held = self.held - missing;
        missing
    }

    /// The batches that are held go on in a new stream.
    pub(super) const fn renew(&mut self, stream: StreamId) {
        self.origin = self.origin.renewed(stream, self.oldest.number, self.stored);
    }
}
