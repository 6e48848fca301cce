//! The simulated aggregator: session, queue of the writer, and database.

use std::collections::{BTreeMap, BTreeSet};

use bytes::Bytes;

use super::super::*;
use super::{SECRET, event_numbers, missing_reported};

/// Work for the writer.
#[derive(Clone, Debug)]
enum Work {
    /// A host sent a hello: its stream, the stream that it replaced, and the batches that are missing in the previous
    /// stream. All are stored in one transaction.
    Hello(StreamId, Option<StreamId>, Option<MissingPreviousBatches>),
    Batch {
        head: BatchHead,
        body: Bytes,
    },
    Damaged(BatchHead),
    MissingBatches(MissingBatches),
}

/// Content of a stream.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) enum Entry {
    /// A batch and its events.
    Batch { number: u64, event_numbers: Vec<u64>, missing_reported: u64 },
    /// A batch that was quarantined.
    Damaged { number: u64, chain: Chain },
    /// Batches that neither end had, and the number of their events.
    Gap { from: u64, through: u64, events: Option<u64> },
}

#[derive(Clone, Debug, Default)]
pub(in super::super) struct Database {
    pub(in super::super) marks: BTreeMap<StreamId, HighWaterMark>,
    pub(in super::super) entries: BTreeMap<StreamId, Vec<Entry>>,
    pub(in super::super) replaced: Vec<StreamId>,
    seen: BTreeSet<StreamId>,
    last: Option<StreamId>,
}

#[derive(Clone, Debug)]
pub(in super::super) struct Aggregator {
    pub(in super::super) receiving: Receiving,
    pub(in super::super) database: Database,
    pub(in super::super) backup: Option<Database>,
    challenges: Challenges<u64>,
    /// `true` if hosts must prove their identity.
    pub(in super::super) asks_for_proofs: bool,
    /// Number of challenges, so that each nonce is different.
    challenged: u64,
    queue: Vec<Work>,
    capacity: usize,
    /// Connection with the host's session.
    route: Option<u64>,
    /// Streams that the host used, including streams in the queue, and the last stream.
    seen: BTreeSet<StreamId>,
    last: Option<StreamId>,
    /// Number of welcomes that reported missing batches.
    pub(in super::super) missing: u32,
}

impl Aggregator {
    pub(super) fn new(capacity: usize) -> Self {
        Self {
            receiving: receiving(),
            database: Database::default(),
            backup: None,
            challenges: challenges(),
            asks_for_proofs: true,
            challenged: 0,
            queue: Vec::new(),
            capacity,
            route: None,
            seen: BTreeSet::new(),
            last: None,
            missing: 0,
        }
    }

    pub(in super::super) const fn is_idle(&self) -> bool {
        self.queue.is_empty()
    }

    pub(super) fn live(&mut self, connection: u64, host: HostId, now: MonoTime) -> Option<ToAgent> {
        if self.route != Some(connection) {
            return Some(ToAgent::Unknown);
        }
        self.receiving.handle_live(host, now)
    }

    /// Handles a frame. Returns the answer for its connection.
    pub(super) fn frame(&mut self, connection: u64, frame: &Bytes, now: MonoTime) -> Option<ToAgent> {
        if let Some(part) = codec::decode_part(frame) {
            if self.route != Some(connection) {
                return Some(ToAgent::Unknown);
            }
            let whole = self.receiving.handle_part(&part, now)?;
            return self.frame(connection, &whole, now);
        }
        if let Some(head) = codec::decode_batch_head(frame) {
            if self.route != Some(connection) {
                return Some(ToAgent::Unknown);
            }
            if self.queue.len() >= self.capacity {
                self.receiving.defer_batch(head.stream);
                return None;
            }
            let body = codec::decode_batch_body(frame.clone());
            return match self.receiving.handle_batch(&head, body.is_ok(), now) {
                Arrival::Accept => {
                    let body = body.expect("only intact batches are accepted");
                    self.queue.push(Work::Batch { head, body });
                    None
                }
                Arrival::AcceptDamaged => {
                    self.queue.push(Work::Damaged(head));
                    None
                }
                Arrival::Duplicate(reply) | Arrival::Unknown(reply) => Some(reply),
                Arrival::Rejected(reply) => reply,
                Arrival::Pending => None,
            };
        }
        match codec::decode(frame).ok()? {
            ToAggregator::Hello(hello) if !self.asks_for_proofs => self.hello(connection, &hello, now),
            ToAggregator::Hello(hello) => {
                self.challenged += 1;
                let mut nonce = [0; 32];
                nonce[..8].copy_from_slice(&self.challenged.to_be_bytes());
                Some(self.challenges.challenge(connection, hello, false, Nonce::from_bytes(nonce), now))
            }
            ToAggregator::Proof(proof) => {
                match self.challenges.check_proof(&connection, proof, Some(&SECRET)) {
                    ProofResult::Valid { hello, .. } => self.hello(connection, &hello, now),
                    ProofResult::Unsolicited => Some(ToAgent::Unknown),
                    ProofResult::Invalid(hello) => panic!("the proof of {hello:?} is wrong"),
                }
            }
            ToAggregator::Echo { host, bytes } if self.route == Some(connection) => {
                Some(self.receiving.handle_echo(host, bytes, now))
            }
            ToAggregator::Echo { .. } => Some(ToAgent::Unknown),
            ToAggregator::Live(_) | ToAggregator::Goodbye(_) => unreachable!("never sent here"),
        }
    }

    fn hello(&mut self, connection: u64, hello: &Hello, now: MonoTime) -> Option<ToAgent> {
        let mark_of = |stream| self.database.marks.get(&stream).copied();
        let record = StreamRecord {
            mark: mark_of(hello.stream),
            was_used: self.seen.contains(&hello.stream),
            last_stream: self.last,
            previous_mark: hello.previous_stream.and_then(mark_of),
            seniority: None,
        };
        match self.receiving.handle_hello(hello, record, now) {
            HelloResult::Welcome { reply, missing, replaced, missing_previous, .. } => {
                self.route = Some(connection);
                self.missing += u32::from(missing.is_some());
                self.queue.push(Work::Hello(hello.stream, replaced, missing_previous));
                self.queue.extend(missing.map(Work::MissingBatches));
                self.last = Some(hello.stream);
                self.seen.insert(hello.stream);
                Some(reply)
            }
            HelloResult::Refused { reply, .. } => Some(reply),
            HelloResult::Wait => None,
        }
    }

    /// Applies the next `count` works to the database. Returns the entries that they stored.
    pub(super) fn commit(&mut self, count: usize) -> Vec<(StreamId, Entry)> {
        let count = count.min(self.queue.len());
        let works: Vec<Work> = self.queue.drain(..count).collect();
        works.into_iter().filter_map(|work| self.database.apply(work)).collect()
    }

    /// Reports the commit. Returns the messages for the connection of the host.
    pub(super) fn report_commit(&mut self, mut streams: Vec<StreamId>) -> Vec<(u64, ToAgent)> {
        streams.dedup();
        let marks = &self.database.marks;
        let mut replies: Vec<_> = streams
            .into_iter()
            .filter_map(|stream| self.receiving.handle_stored(stream, marks[&stream]))
            .collect();
        replies.extend(self.receiving.request_deferred(self.capacity.saturating_sub(self.queue.len())));
        self.to_connection(replies)
    }

    /// Lets the next commit fail, together with all waiting works.
    pub(super) fn fail(&mut self) -> Vec<(u64, ToAgent)> {
        let mut replies = Vec::new();
        for work in std::mem::take(&mut self.queue) {
            match work {
                Work::Batch { head, .. } | Work::Damaged(head) => {
                    replies.extend(self.receiving.handle_failed_store(head.stream));
                }
                Work::MissingBatches(missing) => {
                    replies.extend(self.receiving.handle_failed_store(missing.stream));
                }
                hello @ Work::Hello(..) => self.queue.push(hello),
            }
        }
        self.to_connection(replies)
    }

    pub(in super::super) fn kill(&mut self) {
        self.queue.clear();
        (self.receiving, self.challenges) = (receiving(), challenges());
        self.route = None;
        self.last = self.database.last;
        self.seen = self.database.seen.clone();
    }

    fn to_connection(&self, replies: Vec<(HostId, ToAgent)>) -> Vec<(u64, ToAgent)> {
        replies.into_iter().filter_map(|(_, reply)| Some((self.route?, reply))).collect()
    }
}

fn challenges() -> Challenges<u64> {
    Challenges::new("base".parse().expect("a name"))
}

impl Database {
    /// Applies a work. Returns the stored entry and its stream.
    fn apply(&mut self, work: Work) -> Option<(StreamId, Entry)> {
        let (stream, mark, entry) = match work {
            Work::Hello(stream, replaced, missing_previous) => {
                self.last = Some(stream);
                if self.seen.insert(stream) {
                    self.replaced.extend(replaced);
                    if let Some(MissingPreviousBatches { stream, from, through, events }) = missing_previous {
                        let gap = Entry::Gap { from, through, events };
                        self.entries.entry(stream).or_default().push(gap);
                    }
                }
                return None;
            }
            Work::Batch { head, body } => {
                let previous = self.marks.get(&head.stream);
                if let Some(previous) = previous {
                    assert_eq!(head.number, previous.stored + 1, "stored out of order");
                    assert_eq!(head.previous_chain, previous.chain, "stored after a batch of another chain");
                }
                assert_eq!(head.chain, head.previous_chain.next(head.events, &body));
                let (event_numbers, missing_reported) =
                    (event_numbers(head.events, &body), missing_reported(head.events, &body));
                let entry = Entry::Batch { number: head.number, event_numbers, missing_reported };
                (head.stream, HighWaterMark::from(head), entry)
            }
            Work::Damaged(head) => {
                let entry = Entry::Damaged { number: head.number, chain: head.chain };
                (head.stream, HighWaterMark::from(head), entry)
            }
            Work::MissingBatches(missing) => {
                let MissingBatches { stream, from, through, events, .. } = missing;
                if let Some(previous) = self.marks.get(&stream) {
                    assert_eq!(from, previous.stored + 1, "a gap follows the last stored batch");
                }
                (stream, HighWaterMark::from(missing), Entry::Gap { from, through, events })
            }
        };
        self.marks.insert(stream, mark);
        self.entries.entry(stream).or_default().push(entry.clone());
        Some((stream, entry))
    }
}
