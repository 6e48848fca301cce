//! A spool in memory instead of the agent's file.

use std::collections::BTreeMap;

use peernet_clock::Stamp;
use peernet_stream::{
    Action, ChainHash, NewestSendableBatch, Notice, Sending, SpoolState, SpooledBatch, StreamId, Totals,
    Usage,
};

/// The state that survives the agent's process.
#[derive(Clone, Debug)]
pub(crate) struct Spool {
    pub(crate) stream: StreamId,
    previous_stream: Option<StreamId>,
    first: u64,
    events_before_first: Option<u64>,
    /// Number and chain hash of the last deleted batch.
    deleted: (u64, ChainHash),
    batches: BTreeMap<u64, SpooledBatch>,
    totals: Totals,
    newest_sendable: Vec<NewestSendableBatch>,
}

impl Spool {
    pub(crate) fn new() -> Self {
        Self {
            stream: StreamId::random(),
            previous_stream: None,
            first: 1,
            events_before_first: Some(0),
            deleted: (0, ChainHash::START),
            batches: BTreeMap::new(),
            totals: Totals::default(),
            newest_sendable: Vec::new(),
        }
    }

    /// Returns the state that a spool reports when it is opened.
    pub(crate) fn state(&self) -> SpoolState {
        let newest = self.batches.last_key_value();
        let usages = self
            .batches
            .values()
            .map(|batch| Usage { events: u64::from(batch.events), bytes: batch.body.len() as u64 });
        SpoolState {
            stream: self.stream,
            previous_stream: self.previous_stream,
            first: self.first,
            events_before_first: self.events_before_first,
            oldest: self.deleted.0 + 1,
            chain_before_oldest: self.deleted.1,
            newest: newest.map_or(self.deleted, |(number, batch)| (*number, batch.chain)),
            since: self.batches.first_key_value().map(|(_, batch)| batch.since),
            waiting_usage: usages.fold(Usage::default(), |sum, usage| sum + usage),
            totals: self.totals.clone(),
            newest_sendable: self.newest_sendable.clone(),
            unreported: Vec::new(),
            unresolved: None,
        }
    }

    /// Executes an action of the state machine; no action fails here.
    pub(crate) fn act(&mut self, action: Action, sending: &mut Sending, now: Stamp) -> Option<Notice> {
        match action {
            Action::Append { batches, totals } => {
                self.batches.extend(batches.into_iter().map(|batch| (batch.number, batch)));
                // A new entry replaces the entry of the same process.
                self.newest_sendable
                    .retain(|old| totals.newest_sendable.is_none_or(|new| new.process != old.process));
                self.newest_sendable.extend(totals.newest_sendable);
                self.totals = totals;
                sending.on_appended(now)
            }
            Action::Load { from, bytes } => {
                let mut loaded = Vec::new();
                let mut length = 0;
                for batch in self.batches.range(from..).map(|(_, batch)| batch) {
                    if !loaded.is_empty() && length + batch.body.len() > bytes {
                        break;
                    }
                    length += batch.body.len();
                    loaded.push(batch.clone());
                }
                sending.on_loaded(loaded, now)
            }
            Action::Delete { through, chain } => {
                self.batches.retain(|number, _| *number > through);
                self.deleted = (through, chain);
                sending.on_deleted();
                None
            }
            Action::Renew { stream, previous_stream, first, events_before_first } => {
                self.events_before_first = Some(events_before_first);
                (self.stream, self.previous_stream, self.first) = (stream, Some(previous_stream), first);
                sending.on_renewed(now);
                None
            }
            Action::Send(_) => None,
        }
    }
}
