//! The simulated spool file, which survives the process.

use std::collections::BTreeMap;

use super::super::*;

/// A spool file.
#[derive(Clone, Debug)]
pub(in super::super) struct SpoolFile {
    pub(in super::super) stream: StreamId,
    previous_stream: Option<StreamId>,
    first: u64,
    events_before_first: Option<u64>,
    previous_chain: ChainHash,
    newest: (u64, ChainHash),
    totals: Totals,
    newest_sendable: Vec<NewestSendableBatch>,
    /// Losses that no gap reports yet, each with the value that [`Totals::reported_drops`] has after the loss is
    /// reported.
    unreported: Vec<(u64, Gap)>,
    unresolved: Option<UnresolvedBatches>,
    /// Counts in shared memory, which survive the process.
    pub(super) counted: CountedEvents,
    pub(in super::super) batches: BTreeMap<u64, SpooledBatch>,
}

impl SpoolFile {
    pub(super) fn new(stream: StreamId) -> Self {
        Self {
            stream,
            previous_stream: None,
            first: 1,
            events_before_first: Some(0),
            previous_chain: ChainHash::START,
            newest: (0, ChainHash::START),
            totals: Totals::default(),
            newest_sendable: Vec::new(),
            unreported: Vec::new(),
            unresolved: None,
            counted: CountedEvents::default(),
            batches: BTreeMap::new(),
        }
    }

    /// Returns the state that a process finds in the file.
    pub(super) fn state(&self) -> SpoolState {
        let oldest = self.batches.values().next();
        SpoolState {
            stream: self.stream,
            previous_stream: self.previous_stream,
            first: self.first,
            events_before_first: self.events_before_first,
            oldest: oldest.map_or(self.newest.0 + 1, |batch| batch.number),
            chain_before_oldest: self.previous_chain,
            newest: self.newest,
            since: oldest.map(|batch| batch.since),
            waiting_usage: self.batches.values().fold(Usage::default(), |sum, batch| sum + batch.usage()),
            totals: self.totals.clone(),
            newest_sendable: self.newest_sendable.clone(),
            unreported: self.unreported.iter().map(|(_, gap)| gap.clone()).collect(),
            unresolved: self.unresolved.clone(),
        }
    }

    /// Opens the file for a new process: records the losses of the previous process, and resets the counts.
    pub(super) fn open_for_process(&mut self) -> SpoolState {
        let mut state = self.state();
        state.record_losses_of_killed_process(
            std::mem::take(&mut self.counted),
            self.totals.submitted.settled(),
        );
        state.totals.submitted = SubmittedEvents::default();
        self.totals = state.totals.clone();
        self.unresolved = state.unresolved.clone();
        self.set_unreported(&state.unreported);
        state
    }

    /// Sets the losses to be reported.
    fn set_unreported(&mut self, unreported: &[Gap]) {
        let mut reported = self.totals.reported_drops;
        let with_reported_drops = |gap: &Gap| {
            reported += gap.count;
            (reported, gap.clone())
        };
        self.unreported = unreported.iter().map(with_reported_drops).collect();
    }

    /// Records a batch that is sent without being in the file.
    pub(super) fn record_sent_unspooled(&mut self, sent: SentUnspooled) {
        // The shared memory has `MAX_SENT_UNSPOOLED` places, and the number of a batch determines its place.
        let sent_batches = &mut self.counted.sent;
        sent_batches.retain(|other| {
            other.number % MAX_SENT_UNSPOOLED as u64 != sent.number % MAX_SENT_UNSPOOLED as u64
        });
        sent_batches.push(sent);
    }

    pub(super) fn append(&mut self, batches: &[SpooledBatch], mut totals: Totals) {
        self.unreported.retain(|(reported_through, _)| *reported_through > totals.reported_drops);
        for batch in batches {
            let (newest, chain) = self.newest;
            assert_eq!(batch.number, newest + 1, "numbers in the spool are contiguous");
            assert_eq!(
                batch.chain,
                chain.next(batch.events, &batch.body),
                "each batch in the spool continues the chain hash of the previous batch"
            );
            self.newest = (batch.number, batch.chain);
            self.batches.insert(batch.number, batch.clone());
        }
        if let Some(newest_sendable) = totals.newest_sendable {
            self.newest_sendable.retain(|other| other.process != newest_sendable.process);
            self.newest_sendable.push(newest_sendable);
        }
        let unreported = totals.unreported.take();
        self.totals = totals;
        if let Some(unreported) = unreported {
            self.unresolved = None;
            self.set_unreported(&unreported);
        }
    }

    pub(super) fn load(&self, from: u64, bytes: usize) -> Vec<SpooledBatch> {
        let mut remaining_bytes = bytes;
        let mut loaded = Vec::new();
        for number in from.. {
            let Some(batch) = self.batches.get(&number) else { break };
            if !loaded.is_empty() && batch.body.len() > remaining_bytes {
                break;
            }
            remaining_bytes = remaining_bytes.saturating_sub(batch.body.len());
            loaded.push(batch.clone());
        }
        loaded
    }

    /// Deletes batches, and returns them.
    pub(super) fn delete(&mut self, through: u64, chain: ChainHash) -> Vec<SpooledBatch> {
        let kept = self.batches.split_off(&(through + 1));
        let deleted = std::mem::replace(&mut self.batches, kept);
        if let Some(last) = deleted.get(&through) {
            assert_eq!(last.chain, chain, "the action states the chain hash of the last deleted batch");
        }
        self.previous_chain = chain;
        if through > self.newest.0 {
            // The aggregator stored batches that were never written to the file.
            self.newest = (through, chain);
        }
        deleted.into_values().collect()
    }

    pub(super) fn renew(
        &mut self,
        stream: StreamId,
        previous_stream: StreamId,
        first: u64,
        events_before_first: u64,
    ) {
        assert_eq!(previous_stream, self.stream);
        assert_eq!(first, self.state().oldest, "the new stream begins with the oldest batch in the file");
        (self.stream, self.previous_stream, self.first) = (stream, Some(previous_stream), first);
        self.events_before_first = Some(events_before_first);
    }
}
