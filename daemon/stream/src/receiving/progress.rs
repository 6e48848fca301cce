//! Progress of one stream: which batches are accepted and stored, and which batch is next.

use std::collections::VecDeque;

use super::super::MAX_IN_FLIGHT_BATCHES;
use super::{Arrival, BatchHead, ChainHash, Hello, HighWaterMark, MissingBatches, StreamId, ToAgent};
use peernet_logger::HostId;

/// Largest accepted batch number: the largest integer of SQLite.
pub(super) const MAX_BATCH_NUMBER: u64 = i64::MAX as u64;

/// Number of damaged arrivals in a row after which a batch is accepted as damaged.
const MAX_DAMAGED_ARRIVALS: u32 = 3;

/// Maximum number of accepted batches that are not stored or not confirmed. An agent that respects its window causes at
/// most half as many.
const MAX_PENDING: usize = 2 * (MAX_IN_FLIGHT_BATCHES + 1);

/// A position in a stream: number of a batch; its chain hash and the number of events up to it, if they are known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Position {
    number: u64,
    chain: Option<ChainHash>,
    events: Option<u64>,
}

impl From<HighWaterMark> for Position {
    fn from(mark: HighWaterMark) -> Self {
        Self { number: mark.stored, chain: Some(mark.chain), events: mark.events }
    }
}

/// Position up to which batches of a stream are accepted, and position up to which they are stored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Progress {
    pub(super) host: HostId,
    /// Process that sent the last hello.
    process: u64,
    /// Mark in the database; if `None`, `stored` is the position before the first batch of the stream.
    mark: Option<HighWaterMark>,
    stored: Position,
    accepted: Position,
    /// Number of the last batch that has the same content here and at the connected agent. This is known because the
    /// agent compared the chain hashes when it was welcomed, or because it has sent the batch since then.
    confirmed: u64,
    /// Number and chain hash of each accepted batch that is not stored or not confirmed, in ascending order. A gap is
    /// represented by its last batch.
    pending: VecDeque<(u64, ChainHash)>,
    /// Number of the first batch that was requested again; `None` once this batch arrives.
    requested: Option<u64>,
    /// The last batch that arrived damaged, and the number of its damaged arrivals in a row.
    damaged: Option<(BatchHead, u32)>,
}

impl Progress {
    pub(super) fn new(hello: &Hello, mark: Option<HighWaterMark>) -> Self {
        let start = Position {
            number: hello.first.saturating_sub(1),
            // The hello states the chain hash before the oldest batch. This is the chain hash before the first batch
            // only if no batch was deleted.
            chain: (hello.oldest == hello.first).then_some(hello.chain_before_oldest),
            events: hello.events_before_first,
        };
        let stored = mark.map_or(start, Position::from);
        Self {
            host: hello.host.id,
            process: hello.process,
            mark,
            stored,
            accepted: stored,
            confirmed: stored.number,
            pending: VecDeque::new(),
            requested: None,
            damaged: None,
        }
    }

    /// Updates the progress for the hello of an agent. `is_same_process` is `true` if the process was already connected
    /// with this stream. Returns the batches that neither end has.
    pub(super) fn handle_hello(
        &mut self,
        hello: &Hello,
        mark: Option<HighWaterMark>,
        is_same_process: bool,
    ) -> Option<MissingBatches> {
        if let Some(mark) = mark {
            self.apply_mark(mark);
        }
        // If no batch of the stream is stored or accepted, this hello replaces what an earlier hello stated.
        if self.mark.is_none() && self.is_all_stored() {
            *self = Self::new(hello, None);
        }
        if !is_same_process {
            self.confirmed = self.stored.number;
        }
        (self.requested, self.process) = (None, hello.process);
        let through = hello.oldest.saturating_sub(1);
        (through > self.accepted.number).then(|| {
            let (host, stream, from) = (self.host, hello.stream, self.next());
            let (chain, process, events_through) =
                (hello.chain_before_oldest, hello.process, hello.events_before_oldest);
            let events = self.accepted.events.map(|accepted| events_through.saturating_sub(accepted));
            // The gap takes the place of the batches; the next batch follows it.
            self.accept(through, chain, events_through);
            MissingBatches { host, stream, from, through, chain, process, events, events_through }
        })
    }

    /// Returns whether a batch of the stream is stored and all batches before `oldest` are accepted. No batch is missing
    /// then if the agent's oldest batch is `oldest`.
    pub(super) const fn has_all_before(&self, oldest: u64) -> bool {
        self.mark.is_some() && oldest <= self.next()
    }

    /// Returns the number of the last stored batch, and the mark that the agent compares with its own batches. If no
    /// batch is stored, the number is that of the first batch minus 1.
    pub(super) const fn stored(&self) -> (u64, Option<HighWaterMark>) {
        (self.stored.number, self.mark)
    }

    /// Decides about a batch of the stream from the connected agent.
    pub(super) fn handle_batch(&mut self, head: &BatchHead, is_intact: bool, window: u32) -> Arrival {
        let number = head.number;
        if number <= self.acknowledged_through() {
            Arrival::Duplicate(self.acknowledgement(head.stream, window))
        } else if number <= self.accepted.number {
            self.handle_repeated(head, window)
        } else if number > MAX_BATCH_NUMBER || self.is_full() {
            // Only an agent that ignores its window sends such a batch.
            Arrival::Rejected(None)
        } else if number > self.next() {
            Arrival::Rejected(self.request_next(head.stream))
        } else if !is_intact {
            self.handle_damaged(head)
        } else if self.follows(head) {
            self.accept(number, head.chain, head.events_through());
            Arrival::Accept
        } else {
            // The previous batch is not the last accepted batch: the spool is a copy or was restored. After its next
            // hello, the agent compares the chain hashes of both ends.
            Arrival::Unknown(ToAgent::Unknown)
        }
    }

    /// Handles a batch whose number was accepted before.
    fn handle_repeated(&mut self, head: &BatchHead, window: u32) -> Arrival {
        let number = head.number;
        let pending_batch = self.pending.iter().find(|(pending, _)| *pending == number);
        // `pending` contains only the last of the batches in a gap, and only the last of the batches that a mark of the
        // database added. An earlier batch cannot be compared.
        let Some((_, chain)) = pending_batch else {
            return Arrival::Pending;
        };
        // The batch has the same number and other content: the spool is a copy or was restored. After its next hello,
        // the agent compares the chain hashes of both ends.
        if *chain != head.chain {
            return Arrival::Unknown(ToAgent::Unknown);
        }
        // The chain hash of a batch also identifies every earlier batch.
        self.confirmed = self.confirmed.max(number);
        self.drop_acknowledged();
        match number <= self.stored.number {
            true => Arrival::Duplicate(self.acknowledgement(head.stream, window)),
            false => Arrival::Pending,
        }
    }

    /// Handles the next batch if it does not match its hash: it was damaged in transit or in the spool.
    fn handle_damaged(&mut self, head: &BatchHead) -> Arrival {
        // Only arrivals with the same head are counted: a damaged head looks like the head of another batch.
        let earlier = self.damaged.filter(|(damaged, _)| damaged == head);
        let arrivals = earlier.map_or(0, |(_, arrivals)| arrivals) + 1;
        if arrivals < MAX_DAMAGED_ARRIVALS {
            self.damaged = Some((*head, arrivals));
            // The batch answered the last request, so a new request is needed.
            self.requested = None;
            return Arrival::Rejected(self.request_next(head.stream));
        }
        self.damaged = None;
        if self.follows(head) {
            self.accept(head.number, head.chain, head.events_through());
            Arrival::AcceptDamaged
        } else {
            // The chain hashes in the spool are damaged. The agent finds this when it compares them after its next
            // hello.
            Arrival::Unknown(ToAgent::Unknown)
        }
    }

    /// Returns whether the batch follows the last accepted batch, as its `previous_chain` shows.
    fn follows(&self, head: &BatchHead) -> bool {
        self.accepted.chain == Some(head.previous_chain)
    }

    /// Records all batches up to batch `number` as accepted; `events` is the number of events in these batches and all
    /// earlier batches of the spool.
    fn accept(&mut self, number: u64, chain: ChainHash, events: u64) {
        self.accepted = Position { number, chain: Some(chain), events: Some(events) };
        self.confirmed = number;
        self.pending.push_back((number, chain));
        (self.requested, self.damaged) = (None, None);
        self.drop_acknowledged();
    }

    /// Records that the mark is on disk. Returns an acknowledgement for the connected agent if more batches can be
    /// acknowledged.
    pub(super) fn record_stored(
        &mut self,
        stream: StreamId,
        mark: HighWaterMark,
        window: u32,
    ) -> Option<ToAgent> {
        let previous = self.acknowledged_through();
        self.apply_mark(mark);
        (self.acknowledged_through() > previous).then(|| self.acknowledgement(stream, window))
    }

    /// Applies a mark of the database.
    fn apply_mark(&mut self, mark: HighWaterMark) {
        if self.mark.is_some() && mark.stored <= self.stored.number {
            return;
        }
        self.mark = Some(mark);
        self.stored = mark.into();
        if mark.stored >= self.accepted.number {
            if mark.stored > self.accepted.number {
                // The database is ahead of the accepted batches in memory: the mark's batch was stored before the
                // aggregator was restarted.
                self.pending.push_back((mark.stored, mark.chain));
            }
            self.accepted = self.stored;
        }
        self.drop_acknowledged();
    }

    /// Records that storing failed. Returns the request to send the batches again.
    pub(super) fn record_storing_failure(&mut self, stream: StreamId) -> ToAgent {
        self.accepted = self.stored;
        // Batches after the last stored batch must be sent again, and are then confirmed again.
        self.confirmed = self.confirmed.min(self.stored.number);
        self.pending.retain(|(number, _)| *number <= self.stored.number);
        self.damaged = None;
        self.requested = Some(self.next());
        ToAgent::Resend { stream, from: self.next() }
    }

    /// Returns a request for the next batch; `None` if that batch was already requested.
    pub(super) fn request_next(&mut self, stream: StreamId) -> Option<ToAgent> {
        let from = self.next();
        // One request for each range of missing batches: otherwise each later batch in flight would cause another
        // request.
        let is_new = self.requested != Some(from);
        self.requested = Some(from);
        is_new.then_some(ToAgent::Resend { stream, from })
    }

    /// Forgets the last request, because its answer could not be stored.
    pub(super) const fn forget_request(&mut self) {
        self.requested = None;
    }

    /// Returns whether no batch waits to be stored.
    pub(super) const fn is_all_stored(&self) -> bool {
        self.accepted.number == self.stored.number
    }

    /// Returns whether a batch from another process waits to be stored.
    pub(super) const fn has_unstored_from_other_process(&self, process: u64) -> bool {
        !self.is_all_stored() && self.process != process
    }

    /// Returns whether the maximum number of batches waits to be stored or confirmed.
    pub(super) fn is_full(&self) -> bool {
        self.pending.len() >= MAX_PENDING
    }

    /// Returns the number of the next batch to be accepted.
    const fn next(&self) -> u64 {
        self.accepted.number.saturating_add(1)
    }

    /// Returns the number of the last batch that is stored and that the agent is known to hold.
    fn acknowledged_through(&self) -> u64 {
        self.stored.number.min(self.confirmed)
    }

    /// Removes the batches that are both stored and confirmed from `pending`.
    fn drop_acknowledged(&mut self) {
        let acknowledged_through = self.acknowledged_through();
        while self.pending.front().is_some_and(|(number, _)| *number <= acknowledged_through) {
            self.pending.pop_front();
        }
    }

    fn acknowledgement(&self, stream: StreamId, window: u32) -> ToAgent {
        ToAgent::Ack { stream, through: self.acknowledged_through(), window }
    }
}
