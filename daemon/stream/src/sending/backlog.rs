//! The numbered batches: which there are, where each of them is, and what they take.

use std::collections::VecDeque;

use bytes::Bytes;
use peernet_clock::WallTime;

use super::super::{BatchHead, Chain, HandedIn, SentUnspooled, StreamId};
use super::intake::CutBatch;
use crate::spool::{SpoolState, SpooledBatch, Usage};
use crate::totals::Totals;
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
    pub(super) stream: StreamId,
    pub(super) previous: Option<StreamId>,
    pub(super) first: u64,
    /// Events in all batches before the first; `None` when it is not known.
    pub(super) events_before_first: Option<u64>,
    /// The oldest that is held.
    oldest: u64,
    /// Chain of the one before it.
    before: Chain,
    ready: VecDeque<SpooledBatch>,
    ready_usage: Usage,
    /// The newest that is in the file, and its chain.
    spooled: (u64, Chain),
    pending: VecDeque<Pending>,
    pending_usage: Usage,
    /// What was counted up to the newest that is in the file or stored over there.
    settled: Totals,
    newest: (u64, Chain),
    held: Usage,
    /// The newest that was ever sent by this process.
    sent: u64,
    /// The last that was sent while it was in memory only.
    sent_unspooled: Option<SentUnspooled>,
    /// Events of the batches that were sent and are still held.
    sent_events: u64,
    /// When the first event of the oldest batch came, while that is in the file only.
    since: Option<WallTime>,
    /// Bytes of `ready` from which on the file is not read ahead.
    budget: u64,
}

#[derive(Clone, Debug)]
struct Pending {
    batch: SpooledBatch,
    totals: Totals,
}

/// What an acknowledgement freed.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Freed {
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
        Self {
            stream: spool.stream,
            previous: spool.previous,
            first: spool.first.max(1),
            events_before_first: spool.events_before_first,
            oldest,
            before: spool.before,
            ready: VecDeque::new(),
            ready_usage: Usage::default(),
            spooled: newest,
            pending: VecDeque::new(),
            pending_usage: Usage::default(),
            settled: Totals { handed_in: HandedIn::default(), ..spool.totals.clone() },
            newest,
            held: if newest.0 < oldest { Usage::default() } else { spool.held },
            sent: 0,
            sent_unspooled: None,
            sent_events: 0,
            since: spool.since,
            budget,
        }
    }

    /// Numbers a batch.
    pub(super) fn push(&mut self, cut: CutBatch) {
        let CutBatch { since, events, body, totals } = cut;
        let chain = self.newest.1.then(events, &body);
        self.newest = (self.newest.0 + 1, chain);
        let batch = SpooledBatch { number: self.newest.0, since, events, chain, body };
        self.pending_usage = self.pending_usage + batch.usage();
        self.held = self.held + batch.usage();
        self.pending.push_back(Pending { batch, totals });
    }

    pub(super) const fn oldest(&self) -> u64 {
        self.oldest
    }

    /// The one before the oldest and its chain.
    pub(super) const fn acknowledged(&self) -> (u64, Chain) {
        (self.oldest - 1, self.before)
    }

    pub(super) const fn newest(&self) -> u64 {
        self.newest.0
    }

    pub(super) const fn spooled(&self) -> u64 {
        self.spooled.0
    }

    /// The newest that was ever sent by this process.
    pub(super) const fn sent(&self) -> u64 {
        self.sent
    }

    pub(super) const fn sent_events(&self) -> u64 {
        self.sent_events
    }

    pub(super) const fn sent_unspooled(&self) -> Option<SentUnspooled> {
        self.sent_unspooled
    }

    pub(super) const fn held(&self) -> Usage {
        self.held
    }

    pub(super) const fn pending(&self) -> Usage {
        self.pending_usage
    }

    /// What was counted up to the newest that is in the file or stored over there.
    pub(super) const fn settled(&self) -> &Totals {
        &self.settled
    }

    /// What is in memory only is lost. Returns how many events that are.
    pub(super) fn give_up(&mut self) -> u64 {
        let lost = std::mem::take(&mut self.pending_usage);
        for Pending { batch, .. } in self.pending.drain(..).filter(|one| one.batch.number <= self.sent) {
            self.sent_events = self.sent_events.saturating_sub(u64::from(batch.events));
        }
        self.held = self.held - lost;
        lost.events
    }

    /// What is in the file only.
    pub(super) fn filed(&self) -> Usage {
        self.held - self.ready_usage - self.pending_usage
    }

    /// When the first event of the oldest batch came.
    pub(super) fn since(&self) -> Option<WallTime> {
        let held = self.ready.front().or(self.pending.front().map(|pending| &pending.batch));
        match held {
            Some(batch) if batch.number == self.oldest => Some(batch.since),
            _ => self.since,
        }
    }

    /// The first that is not known in memory; beyond `spooled` when the file holds no other.
    pub(super) fn unknown(&self) -> u64 {
        self.oldest + self.ready.len() as u64
    }

    /// Bytes that are read at once: a quarter of what is kept, so that the next part is read while the others are under
    /// way.
    pub(super) fn part_bytes(&self) -> usize {
        usize::try_from(self.budget / 4).unwrap_or(usize::MAX)
    }

    /// Whether the next part is to be read from the file, beginning with [`unknown`](Self::unknown).
    pub(super) fn wants_more(&self) -> bool {
        self.unknown() <= self.spooled.0 && self.ready_usage.bytes + self.budget / 4 <= self.budget
    }

    /// What the next transaction of the spool is to hold: the pending batches up to so many bytes, and what was
    /// counted up to the last of them.
    pub(super) fn to_append(&self, most: usize, most_bytes: u64) -> Option<(Vec<SpooledBatch>, Totals)> {
        let mut bytes = 0;
        let chosen = self.pending.iter().take(most).take_while(|pending| {
            let first = bytes == 0;
            bytes += pending.batch.body.len() as u64;
            first || bytes <= most_bytes
        });
        let mut totals = None;
        let batches: Vec<_> =
            chosen.map(|pending| (totals = Some(&pending.totals), pending.batch.clone()).1).collect();
        Some((batches, totals?.clone()))
    }

    /// Batches up to and including this one, with this chain, are in the file. Returns the bytes of those that are
    /// held.
    pub(super) fn appended(&mut self, through: u64, chain: Chain) -> u64 {
        let mut bytes = 0;
        self.passed(through, chain);
        while let Some(pending) = self.pending.pop_front_if(|pending| pending.batch.number <= through) {
            let (batch, usage) = (pending.batch.clone(), pending.batch.usage());
            self.settled = pending.totals;
            self.pending_usage = self.pending_usage - usage;
            bytes += usage.bytes;
            let fits = self.ready_usage.bytes + usage.bytes <= self.budget;
            if batch.number == self.unknown() && (fits || batch.number <= self.sent) {
                self.keep(batch);
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
                self.keep(batch);
            }
        }
        self.ready.len() - known
    }

    fn keep(&mut self, batch: SpooledBatch) {
        self.ready_usage = self.ready_usage + batch.usage();
        self.ready.push_back(batch);
    }

    /// The frame's parts of a batch that is in memory, the spooled ones only or all.
    pub(super) fn get(&self, number: u64, unspooled: bool) -> Option<&SpooledBatch> {
        if number < self.oldest {
            return None;
        }
        if let Some(batch) = self.ready.get((number - self.oldest) as usize) {
            return Some(batch);
        }
        let first = self.pending.front().filter(|_| unspooled)?.batch.number;
        self.pending.get(number.checked_sub(first)? as usize).map(|pending| &pending.batch)
    }

    /// The chain of a batch where it is known without the file.
    pub(super) fn chain(&self, number: u64) -> Option<Chain> {
        match number {
            _ if number == self.oldest - 1 => Some(self.before),
            _ if number == self.spooled.0 && number >= self.oldest => Some(self.spooled.1),
            _ => self.get(number, true).map(|batch| batch.chain),
        }
    }

    /// The head and body of a batch to be sent; it counts as sent. `passed` events are in the batches before the oldest.
    pub(super) fn send(
        &mut self,
        number: u64,
        unspooled: bool,
        (host, process): (HostId, u64),
        passed: u64,
    ) -> Option<(BatchHead, Bytes)> {
        let before = self.chain(number.checked_sub(1)?)?;
        let batch = self.get(number, unspooled)?;
        let (chain, events, body) = (batch.chain, batch.events, batch.body.clone());
        if number > self.spooled.0
            && let Some(pending) = self.pending.iter().find(|pending| pending.batch.number == number)
        {
            let Totals { produced, dropped, told, handed_in, .. } = &pending.totals;
            let (taken, events) = (handed_in.taken.all, produced - dropped);
            self.sent_unspooled = Some(SentUnspooled { process, number, taken, told: *told, events });
        }
        if number > self.sent {
            self.sent = number;
            self.sent_events += u64::from(events);
        }
        let head = BatchHead {
            host,
            stream: self.stream,
            process,
            number,
            before,
            chain,
            events,
            events_before: passed + self.events_before(number),
        };
        Some((head, body))
    }

    /// How many events the batches hold from the oldest to the one before this, all of which are in memory.
    fn events_before(&self, number: u64) -> u64 {
        let ready = self.ready.iter();
        let pending = self.pending.iter().map(|pending| &pending.batch);
        let before = ready.chain(pending).take_while(|batch| batch.number < number);
        before.map(|batch| u64::from(batch.events)).sum()
    }

    /// Batches up to and including `through` are stored over there: they are all in memory, or `skimmed` says what the
    /// ones in the file only take and the chain of the last of them.
    ///
    /// Batches up to and including `writing` are being written to the file.
    pub(super) fn free(&mut self, through: u64, skimmed: Option<(Usage, Chain)>, writing: u64) -> Freed {
        let mut freed = Freed::default();
        while let Some(batch) = self.ready.pop_front_if(|batch| batch.number <= through) {
            self.ready_usage = self.ready_usage - batch.usage();
            self.held = self.held - batch.usage();
            freed.spooled_bytes += batch.usage().bytes;
            self.forget(&batch, &mut freed);
        }
        if let Some((usage, chain)) = skimmed {
            self.held = self.held - usage;
            freed.events += usage.events;
            freed.spooled_bytes += usage.bytes;
            (self.oldest, self.before) = (through.min(self.spooled.0) + 1, chain);
            self.since = None;
        }
        while let Some(pending) = self.pending.pop_front_if(|pending| pending.batch.number <= through) {
            self.pending_usage = self.pending_usage - pending.batch.usage();
            self.held = self.held - pending.batch.usage();
            self.settled = pending.totals;
            if pending.batch.number <= writing {
                freed.writing_bytes += pending.batch.usage().bytes;
            }
            self.forget(&pending.batch, &mut freed);
        }
        freed
    }

    fn forget(&mut self, batch: &SpooledBatch, freed: &mut Freed) {
        freed.events += u64::from(batch.events);
        if batch.number <= self.sent {
            self.sent_events = self.sent_events.saturating_sub(u64::from(batch.events));
        }
        (self.oldest, self.before) = (batch.number + 1, batch.chain);
    }

    /// The oldest batches up to the one before `resume` do not exist any more; none of them is in memory. `before` is
    /// the chain of the last of them.
    pub(super) fn skip_to(&mut self, resume: u64, before: Chain) {
        (self.oldest, self.before, self.since) = (resume, before, None);
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

    /// The batches that are held go on in a new stream. `passed` events are in the batches before them.
    pub(super) fn renew(&mut self, stream: StreamId, passed: u64) {
        self.previous = Some(std::mem::replace(&mut self.stream, stream));
        self.first = self.oldest;
        self.events_before_first = Some(passed);
    }
}
