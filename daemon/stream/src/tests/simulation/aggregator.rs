//! The simulated aggregator: session, queue of the writer, and database.

use std::collections::{BTreeMap, BTreeSet};

use bytes::Bytes;

use super::super::*;
use super::{SECRET, event_numbers, missing_in_gaps};

/// Task of the writer.
#[derive(Clone, Debug)]
enum WriterTask {
    /// A host sent a hello: the hello's stream, the stream that this stream replaced, and the batches that are missing
    /// in the previous stream. All are stored in one transaction.
    Hello(StreamId, Option<StreamId>, Option<MissingPreviousBatches>),
    Batch {
        head: BatchHead,
        body: Bytes,
    },
    Damaged(BatchHead),
    MissingBatches(MissingBatches),
}

/// An entry of a stream in the database.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) enum Entry {
    /// A batch and its events.
    Batch { number: u64, event_numbers: Vec<u64>, missing_in_gaps: u64 },
    /// A batch that was quarantined.
    Damaged { number: u64, chain: ChainHash },
    /// Batches that neither end had, and the number of their events.
    Gap { from: u64, through: u64, events: Option<u64> },
}

#[derive(Clone, Debug, Default)]
pub(in super::super) struct Database {
    pub(in super::super) marks: BTreeMap<StreamId, HighWaterMark>,
    pub(in super::super) entries: BTreeMap<StreamId, Vec<Entry>>,
    pub(in super::super) replaced: Vec<StreamId>,
    used_streams: BTreeSet<StreamId>,
    last_stream: Option<StreamId>,
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
    challenge_count: u64,
    queue: Vec<WriterTask>,
    capacity: usize,
    /// Connection with the host's session.
    session_connection: Option<u64>,
    /// Streams that the host used, including streams in the queue.
    used_streams: BTreeSet<StreamId>,
    /// Stream that the host used most recently.
    last_stream: Option<StreamId>,
    /// Number of welcomes that reported missing batches.
    pub(in super::super) missing_batch_reports: u32,
}

impl Aggregator {
    pub(super) fn new(capacity: usize) -> Self {
        Self {
            receiving: receiving(),
            database: Database::default(),
            backup: None,
            challenges: challenges(),
            asks_for_proofs: true,
            challenge_count: 0,
            queue: Vec::new(),
            capacity,
            session_connection: None,
            used_streams: BTreeSet::new(),
            last_stream: None,
            missing_batch_reports: 0,
        }
    }

    pub(in super::super) const fn is_idle(&self) -> bool {
        self.queue.is_empty()
    }

    pub(super) fn handle_live(&mut self, connection: u64, host: HostId, now: MonoTime) -> Option<ToAgent> {
        if self.session_connection != Some(connection) {
            return Some(ToAgent::Unknown);
        }
        self.receiving.handle_live(host, now)
    }

    /// Handles a frame. Returns the answer for its connection.
    pub(super) fn handle_frame(&mut self, connection: u64, frame: &Bytes, now: MonoTime) -> Option<ToAgent> {
        if let Some(part) = codec::decode_part(frame) {
            if self.session_connection != Some(connection) {
                return Some(ToAgent::Unknown);
            }
            let whole = self.receiving.handle_part(&part, now)?;
            return self.handle_frame(connection, &whole, now);
        }
        if let Some(head) = codec::decode_batch_head(frame) {
            if self.session_connection != Some(connection) {
                return Some(ToAgent::Unknown);
            }
            if self.queue.len() >= self.capacity {
                self.receiving.defer_batch(head.host, head.stream);
                return None;
            }
            let body = codec::decode_batch_body(frame.clone());
            return match self.receiving.handle_batch(&head, body.is_ok(), now) {
                Arrival::Accept => {
                    let body = body.expect("only intact batches are accepted");
                    self.queue.push(WriterTask::Batch { head, body });
                    None
                }
                Arrival::AcceptDamaged => {
                    self.queue.push(WriterTask::Damaged(head));
                    None
                }
                Arrival::Duplicate(reply) | Arrival::Unknown(reply) => Some(reply),
                Arrival::Rejected(reply) => reply,
                Arrival::Pending => None,
            };
        }
        match codec::decode(frame).ok()? {
            ToAggregator::Hello(hello) if !self.asks_for_proofs => self.handle_hello(connection, &hello, now),
            ToAggregator::Hello(hello) => {
                self.challenge_count += 1;
                let mut nonce = [0; 32];
                nonce[..8].copy_from_slice(&self.challenge_count.to_be_bytes());
                // The aggregator has the secret of the host.
                let enrol = false;
                Some(self.challenges.challenge(connection, hello, enrol, Nonce::from_bytes(nonce), now))
            }
            ToAggregator::Proof(proof) => {
                match self.challenges.check_proof(&connection, proof, Some(&SECRET)) {
                    ProofResult::Valid { hello, .. } => self.handle_hello(connection, &hello, now),
                    ProofResult::Unsolicited => Some(ToAgent::Unknown),
                    ProofResult::Invalid(hello) => panic!("the proof of {hello:?} is wrong"),
                }
            }
            ToAggregator::Echo { host, bytes } if self.session_connection == Some(connection) => {
                Some(self.receiving.handle_echo(host, bytes, now))
            }
            ToAggregator::Echo { .. } => Some(ToAgent::Unknown),
            ToAggregator::Live(_) | ToAggregator::Goodbye(_) => {
                unreachable!("the simulation does not send these messages")
            }
        }
    }

    fn handle_hello(&mut self, connection: u64, hello: &Hello, now: MonoTime) -> Option<ToAgent> {
        let mark_of = |stream| self.database.marks.get(&stream).copied();
        let record = StreamRecord {
            mark: mark_of(hello.stream),
            was_used: self.used_streams.contains(&hello.stream),
            last_stream: self.last_stream,
            previous_mark: hello.previous_stream.and_then(mark_of),
            seniority: None,
        };
        match self.receiving.handle_hello(hello, record, now) {
            HelloResult::Welcome { reply, missing, replaced, missing_previous, .. } => {
                self.session_connection = Some(connection);
                self.missing_batch_reports += u32::from(missing.is_some());
                self.queue.push(WriterTask::Hello(hello.stream, replaced, missing_previous));
                self.queue.extend(missing.map(WriterTask::MissingBatches));
                self.last_stream = Some(hello.stream);
                self.used_streams.insert(hello.stream);
                Some(reply)
            }
            HelloResult::Refused { reply, .. } => Some(reply),
            HelloResult::Wait => None,
        }
    }

    /// Applies the next `count` tasks to the database. Returns the entries that the tasks stored.
    pub(super) fn commit(&mut self, count: usize) -> Vec<(StreamId, Entry)> {
        let count = count.min(self.queue.len());
        let tasks: Vec<WriterTask> = self.queue.drain(..count).collect();
        tasks.into_iter().filter_map(|task| self.database.apply(task)).collect()
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

    /// Lets the next commit and all waiting tasks fail, except hellos: the welcome is sent already, and the agent does
    /// not repeat a welcomed hello.
    pub(super) fn fail_commit(&mut self) -> Vec<(u64, ToAgent)> {
        let mut replies = Vec::new();
        for task in std::mem::take(&mut self.queue) {
            match task {
                WriterTask::Batch { head, .. } | WriterTask::Damaged(head) => {
                    replies.extend(self.receiving.handle_failed_store(head.stream));
                }
                WriterTask::MissingBatches(missing) => {
                    replies.extend(self.receiving.handle_failed_store(missing.stream));
                }
                hello @ WriterTask::Hello(..) => self.queue.push(hello),
            }
        }
        self.to_connection(replies)
    }

    pub(in super::super) fn kill(&mut self) {
        self.queue.clear();
        (self.receiving, self.challenges) = (receiving(), challenges());
        self.session_connection = None;
        self.last_stream = self.database.last_stream;
        self.used_streams = self.database.used_streams.clone();
    }

    fn to_connection(&self, replies: Vec<(HostId, ToAgent)>) -> Vec<(u64, ToAgent)> {
        replies.into_iter().filter_map(|(_, reply)| Some((self.session_connection?, reply))).collect()
    }
}

fn challenges() -> Challenges<u64> {
    Challenges::new("base".parse().expect("a name"))
}

impl Database {
    /// Applies a task. Returns the stored entry and its stream.
    fn apply(&mut self, task: WriterTask) -> Option<(StreamId, Entry)> {
        let (stream, mark, entry) = match task {
            WriterTask::Hello(stream, replaced, missing_previous) => {
                self.last_stream = Some(stream);
                if self.used_streams.insert(stream) {
                    self.replaced.extend(replaced);
                    if let Some(MissingPreviousBatches { stream, from, through, events }) = missing_previous {
                        let gap = Entry::Gap { from, through, events };
                        self.entries.entry(stream).or_default().push(gap);
                    }
                }
                return None;
            }
            WriterTask::Batch { head, body } => {
                let previous = self.marks.get(&head.stream);
                if let Some(previous) = previous {
                    assert_eq!(head.number, previous.stored + 1, "batches are stored in order");
                    assert_eq!(
                        head.previous_chain, previous.chain,
                        "a batch continues the chain hash of the last stored batch"
                    );
                }
                assert_eq!(head.chain, head.previous_chain.next(head.events, &body));
                let (event_numbers, missing_in_gaps) =
                    (event_numbers(head.events, &body), missing_in_gaps(head.events, &body));
                let entry = Entry::Batch { number: head.number, event_numbers, missing_in_gaps };
                (head.stream, HighWaterMark::from(head), entry)
            }
            WriterTask::Damaged(head) => {
                let entry = Entry::Damaged { number: head.number, chain: head.chain };
                (head.stream, HighWaterMark::from(head), entry)
            }
            WriterTask::MissingBatches(missing) => {
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
