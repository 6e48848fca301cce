//! Expected content of the database, computed from everything that happens in the simulation.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use bytes::Bytes;

use super::super::*;
use super::aggregator::{Aggregator, Database, Entry};
use super::{SpoolFile, event_numbers, missing_in_gaps};

#[derive(Clone, Debug, Default)]
pub(in super::super) struct ExpectedContent {
    /// Events that were in a spool and not deleted with it.
    spooled: BTreeSet<u64>,
    /// Streams and numbers of the batches that were in a spool.
    spooled_batches: BTreeSet<(StreamId, u64)>,
    /// For each event, the streams and batch numbers with which the event has been stored so far.
    places: BTreeMap<u64, BTreeSet<(StreamId, u64)>>,
    /// Content of the sent batches by their chain hashes: the batch's events, and the number of missing events that its
    /// gaps report.
    contents: HashMap<ChainHash, (Vec<u64>, u64)>,
    /// Number of events of each sent batch, by stream and batch number.
    event_counts: BTreeMap<(StreamId, u64), u64>,
    /// Sent parts of the batch that is being sent in parts.
    parts: Vec<u8>,
    /// Wire forms of the events of the sent batches, each batch once.
    pub(in super::super) bodies: Vec<(u32, Bytes)>,
    /// Streams whose spool was deleted.
    deleted_streams: BTreeSet<StreamId>,
    /// `true` if a spool was copied: events that both copies hold may be in two streams.
    pub(super) was_spool_copied: bool,
    /// `true` if the database was replaced by an older copy.
    pub(super) was_database_restored: bool,
}

impl ExpectedContent {
    pub(super) fn record_sent(&mut self, frame: &Bytes) {
        if let Some(part) = codec::decode_part(frame) {
            self.parts.truncate(part.offset as usize);
            self.parts.extend_from_slice(&part.bytes);
            if self.parts.len() == part.total as usize {
                let whole = std::mem::take(&mut self.parts);
                self.record_sent(&whole.into());
            }
            return;
        }
        let Some(head) = codec::decode_batch_head(frame) else { return };
        let body = codec::decode_batch_body(frame.clone()).expect("a batch is intact when it is sent");
        self.event_counts.insert((head.stream, head.number), head.events.into());
        if self
            .contents
            .insert(head.chain, (event_numbers(head.events, &body), missing_in_gaps(head.events, &body)))
            .is_none()
        {
            self.bodies.push((head.events, body));
        }
    }

    pub(super) fn is_damaged(&self, frame: &Bytes) -> bool {
        codec::decode_batch_head(frame).is_some() && codec::decode_batch_body(frame.clone()).is_err()
    }

    pub(super) fn record_appended(&mut self, stream: StreamId, batch: &SpooledBatch) {
        self.spooled_batches.insert((stream, batch.number));
        self.spooled.extend(event_numbers(batch.events, &batch.body));
    }

    /// Records that the batches of a spool belong to its new stream.
    pub(super) fn record_renewed(&mut self, file: &SpoolFile) {
        self.spooled_batches.extend(file.batches.keys().map(|number| (file.stream, *number)));
    }

    /// Checks that the deleted batches are stored.
    pub(super) fn check_deletion(&self, batches: &[SpooledBatch]) {
        for event_number in batches.iter().flat_map(|batch| event_numbers(batch.events, &batch.body)) {
            assert!(
                self.places.contains_key(&event_number),
                "event {event_number} was deleted before it was stored"
            );
        }
    }

    /// Records that a spool was deleted with its content.
    pub(super) fn record_deleted_spool(&mut self, file: &SpoolFile) {
        self.deleted_streams.insert(file.stream);
        for event_number in file.batches.values().flat_map(|batch| event_numbers(batch.events, &batch.body)) {
            self.spooled.remove(&event_number);
        }
    }

    pub(super) fn record_committed(&mut self, stream: StreamId, entry: &Entry) {
        for (number, event_number) in self.events(entry) {
            self.places.entry(event_number).or_default().insert((stream, number));
        }
    }

    /// Returns the events of an entry with their batch numbers. A quarantined batch counts, too.
    fn events(&self, entry: &Entry) -> Vec<(u64, u64)> {
        let (number, event_numbers) = match entry {
            Entry::Batch { number, event_numbers, .. } => (*number, event_numbers.clone()),
            Entry::Damaged { number, chain } => {
                (*number, self.contents.get(chain).cloned().unwrap_or_default().0)
            }
            Entry::Gap { .. } => return Vec::new(),
        };
        event_numbers.into_iter().map(|event_number| (number, event_number)).collect()
    }

    /// Checks the database when no event waits.
    pub(super) fn check(&self, aggregator: &Aggregator) {
        let database = &aggregator.database;
        let mut stored: BTreeMap<u64, u32> = BTreeMap::new();
        for entries in database.entries.values() {
            let event_numbers: Vec<u64> = entries
                .iter()
                .flat_map(|entry| self.events(entry))
                .map(|(_, event_number)| event_number)
                .collect();
            assert!(
                event_numbers.windows(2).all(|pair| pair[0] < pair[1]),
                "the events of a stream are in order and stored once: {event_numbers:?}"
            );
            event_numbers.iter().for_each(|event_number| *stored.entry(*event_number).or_default() += 1);
        }
        for (event_number, times) in &stored {
            assert!(*times == 1 || self.was_spool_copied, "event {event_number} is stored {times} times");
        }
        for event_number in self.spooled.iter().filter(|event_number| !stored.contains_key(event_number)) {
            assert!(
                self.was_database_restored && self.is_accounted(*event_number, database),
                "event {event_number} is lost"
            );
        }
        self.check_replaced_spools(database);
        self.check_gaps(database);
    }

    /// Checks that every submitted event is stored or reported in a gap, regardless of when processes were killed.
    pub(super) fn check_totals(&self, offered: u64, aggregator: &Aggregator) {
        if self.was_database_restored || self.was_spool_copied || !self.deleted_streams.is_empty() {
            return;
        }
        let entries = aggregator.database.entries.values().flatten();
        let (mut stored, mut missing) = (0, 0);
        for entry in entries {
            stored += self.events(entry).len() as u64;
            missing += match entry {
                Entry::Batch { missing_in_gaps, .. } => *missing_in_gaps,
                Entry::Damaged { chain, .. } => {
                    self.contents.get(chain).map_or(0, |(_, missing_in_gaps)| *missing_in_gaps)
                }
                Entry::Gap { .. } => 0,
            };
        }
        assert_eq!(stored + missing, offered, "{stored} events are stored and gaps report {missing} events");
    }

    /// Checks that each gap states the number of events of its batches. If a spool was copied, this number is unknown.
    fn check_gaps(&self, database: &Database) {
        for (stream, entry) in database
            .entries
            .iter()
            .flat_map(|(stream, entries)| entries.iter().map(move |entry| (stream, entry)))
        {
            let Entry::Gap { from, through, events } = entry else { continue };
            let numbers = || (*from..=*through).map(|number| (*stream, number));
            let held: Option<u64> = numbers().map(|batch| self.event_counts.get(&batch)).sum();
            if let (false, Some(held)) = (self.was_spool_copied, held) {
                // A restored database may also lack batches that were sent from memory and never spooled. If these
                // batches follow the last batch in the spool, the gap also states their events, although it does not
                // state their numbers. If the agent was killed after it had sent them, the gap of the killed process
                // states their events, and this gap states the events of the spooled batches only.
                let spooled = numbers().filter(|batch| self.spooled_batches.contains(batch));
                let spooled = spooled.filter_map(|batch| self.event_counts.get(&batch)).sum();
                let is_correct =
                    *events == Some(held) || self.was_database_restored && *events >= Some(spooled);
                assert!(
                    is_correct,
                    "the gap states {events:?} events for batches {from} to {through}, which contain {held}"
                );
            }
        }
    }

    /// Returns whether a gap covers an event that is missing in a restored database, or the event's spool was deleted.
    /// If a spool was copied, different batches with the same numbers may be missing in the database.
    fn is_accounted(&self, event_number: u64, database: &Database) -> bool {
        self.places.get(&event_number).into_iter().flatten().any(|(stream, number)| {
            let entries = database.entries.get(stream).into_iter().flatten();
            let covers = |entry: &Entry| matches!(entry, Entry::Gap { from, through, .. } if (from..=through).contains(&number));
            entries.clone().any(covers) || self.deleted_streams.contains(stream) || self.was_spool_copied
        })
    }

    fn check_replaced_spools(&self, database: &Database) {
        if self.was_database_restored || self.was_spool_copied {
            return;
        }
        let mut replaced = database.replaced.clone();
        replaced.sort();
        replaced.dedup();
        assert_eq!(replaced.len(), database.replaced.len(), "a replaced spool is reported once");
        assert!(
            replaced.is_empty() || !self.deleted_streams.is_empty(),
            "a spool is reported as replaced although none was deleted"
        );
        let stored_streams =
            self.deleted_streams.iter().filter(|stream| database.entries.contains_key(stream));
        stored_streams.for_each(|stream| assert!(replaced.contains(stream), "a deleted spool is reported"));
    }
}
