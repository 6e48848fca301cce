//! The agent's end with a simulated spool file that can fail. The test itself sends the aggregator's messages.

mod batches;
mod comparison;
mod dropped_events;
mod failing_spool;
mod fast_link;
mod hostile_aggregator;
mod link;
mod missing_batches;
mod model;
mod proof;
mod slow_link;
mod spooled_backlog;
mod window;

use std::collections::BTreeMap;

use bytes::Bytes;
use peernet_clock::{ClockIdentity, MonoTime, Span, Stamp, WallTime};

use super::super::{
    Accounting, BatchHead, ChainHash, Event, Hardware, Hello, HostDescription, HostSecret, Incident,
    IncidentKind, Proof, StreamId, ToAgent, ToAggregator, codec,
};
use super::{Action, Notice, Sending, SendingConfig};
use crate::spool::{SpoolState, SpooledBatch, Usage};
use crate::totals::{NewestSendableBatch, Totals};
use peernet_logger::HostId;

fn at(millis: i64) -> Stamp {
    Stamp::default() + Span::from_millis(millis)
}

fn incident(text: &str) -> Event {
    Event::Incident(Incident {
        at: WallTime::from_unix_nanos(0),
        kind: IncidentKind::Control,
        pipeline: None,
        run: None,
        peer: None,
        text: text.into(),
    })
}

/// Returns a configuration with one event per batch. A window counts units of `batch_bytes`, and a batch of these tests
/// counts as one unit: `batch_bytes` is the smallest weight of a batch ([`batch_weight`](crate::batch_weight)).
fn config() -> SendingConfig {
    SendingConfig {
        batch_nodes: 1,
        batch_bytes: 1_024,
        window: 3,
        reserve_events: 2,
        ..SendingConfig::default()
    }
}

/// A simulated spool file, which survives the process.
#[derive(Clone, Debug)]
struct File {
    stream: StreamId,
    previous_stream: Option<StreamId>,
    first: u64,
    events_before_first: Option<u64>,
    previous_chain: ChainHash,
    newest: (u64, ChainHash),
    totals: Totals,
    newest_sendable: Vec<NewestSendableBatch>,
    /// Number of processes that opened the file.
    processes: u64,
    batches: BTreeMap<u64, SpooledBatch>,
}

impl File {
    fn new() -> Self {
        Self {
            stream: StreamId::random(),
            previous_stream: None,
            first: 1,
            events_before_first: Some(0),
            previous_chain: ChainHash::START,
            newest: (0, ChainHash::START),
            totals: Totals::default(),
            newest_sendable: Vec::new(),
            processes: 0,
            batches: BTreeMap::new(),
        }
    }

    fn state(&self) -> SpoolState {
        let oldest = self.batches.values().next();
        SpoolState {
            stream: self.stream,
            previous_stream: self.previous_stream,
            first: self.first,
            events_before_first: self.events_before_first,
            oldest: oldest.map_or(self.newest.0 + 1, |batch| batch.number),
            chain_before_oldest: if oldest.is_some() { self.previous_chain } else { self.newest.1 },
            newest: self.newest,
            since: oldest.map(|batch| batch.since),
            waiting_usage: self.batches.values().fold(Usage::default(), |sum, batch| sum + batch.usage()),
            totals: self.totals.clone(),
            newest_sendable: self.newest_sendable.clone(),
            unreported: Vec::new(),
            unresolved: None,
        }
    }

    fn append(&mut self, batches: Vec<SpooledBatch>, totals: Totals) {
        for batch in batches {
            assert_eq!(batch.number, self.newest.0 + 1, "batch numbers are contiguous");
            assert_eq!(batch.chain, self.newest.1.next(batch.events, &batch.body));
            self.newest = (batch.number, batch.chain);
            self.batches.insert(batch.number, batch);
        }
        self.newest_sendable.retain(|newest_sendable| {
            totals.newest_sendable.is_none_or(|added| added.process != newest_sendable.process)
        });
        self.newest_sendable.extend(totals.newest_sendable);
        self.totals = totals;
    }

    fn load(&self, from: u64, bytes: usize) -> Vec<SpooledBatch> {
        let mut loaded_bytes = 0;
        let contiguous = (from..).map_while(|number| self.batches.get(&number));
        let loaded = contiguous.take_while(|batch| {
            let is_first = loaded_bytes == 0;
            loaded_bytes += batch.body.len();
            is_first || loaded_bytes <= bytes
        });
        loaded.cloned().collect()
    }

    fn delete(&mut self, through: u64, chain: ChainHash) {
        self.batches = self.batches.split_off(&(through + 1));
        self.previous_chain = chain;
        if through > self.newest.0 {
            self.newest = (through, chain);
        }
    }
}

/// An agent, its spool, and its output.
struct Agent {
    config: SendingConfig,
    host: HostId,
    file: File,
    sending: Sending,
    /// Simulated time, milliseconds.
    millis: i64,
    /// `true` while the spool fails.
    spool_is_broken: bool,
    /// `true` while the spool accepts no batches.
    rejects_batches: bool,
    sent: Vec<BatchHead>,
    /// Sent parts of a batch whose other parts are not sent yet.
    parts: Vec<u8>,
    hellos: Vec<Hello>,
    proofs: Vec<Proof>,
    notices: Vec<Notice>,
    /// Actions that the spool was asked to perform.
    actions: Vec<Action>,
}

impl Agent {
    fn new(config: SendingConfig) -> Self {
        Self::open(config, HostId::random(), File::new())
    }

    fn open(config: SendingConfig, host: HostId, mut file: File) -> Self {
        file.processes += 1;
        let description = HostDescription {
            id: host,
            name: "edge".parse().expect("a name"),
            clock: ClockIdentity::new("boot", "system"),
            version: "0.1.0".into(),
            hardware: Hardware::default(),
            serves: None,
            models: Vec::new(),
        };
        let sending = Sending::new(config, description, HostSecret::random(), file.processes, file.state());
        let (sent, parts, hellos, proofs, notices, actions) = Default::default();
        Self {
            config,
            host,
            file,
            sending,
            millis: 0,
            spool_is_broken: false,
            rejects_batches: false,
            sent,
            parts,
            hellos,
            proofs,
            notices,
            actions,
        }
    }

    /// Creates an agent that is connected and welcomed.
    fn new_welcomed(config: SendingConfig) -> Self {
        let mut agent = Self::new(config);
        agent.connect();
        agent.welcome(0, None);
        agent
    }

    /// Kills the process and starts a new process with the same spool file.
    fn restart(self) -> Self {
        Self::open(self.config, self.host, self.file)
    }

    fn now(&self) -> Stamp {
        at(self.millis)
    }

    /// Performs all actions.
    fn settle(&mut self) {
        while let Some(action) = self.sending.next(self.now().mono) {
            // `accounting` asserts that the numbers of events add up.
            let _ = self.accounting();
            match action {
                Action::Send(frame) => self.record_frame(frame.into()),
                action => {
                    self.actions.push(action.clone());
                    self.perform(action);
                }
            }
        }
        // A deadline of `MonoTime::default()` means "at once". Other past deadlines may remain until the next tick.
        let is_due = self.sending.deadline().is_some_and(|deadline| deadline < self.now().mono);
        assert!(
            !is_due || self.sending.deadline() != Some(MonoTime::default()),
            "nothing is due at once after all actions are performed"
        );
    }

    fn record_frame(&mut self, frame: Bytes) {
        if let Some(part) = codec::decode_part(&frame) {
            if part.offset == 0 {
                self.parts.clear();
            }
            assert_eq!(self.parts.len(), part.offset as usize, "parts are sent in order");
            self.parts.extend_from_slice(&part.bytes);
            if self.parts.len() == part.total as usize {
                let whole = std::mem::take(&mut self.parts);
                self.record_frame(whole.into());
            }
            return;
        }
        match codec::decode_batch_head(&frame) {
            Some(head) => {
                codec::decode_batch_body(frame).expect("the sent batch is intact");
                self.sent.push(head);
            }
            None => match codec::decode(&frame) {
                Ok(ToAggregator::Hello(hello)) => self.hellos.push(hello),
                Ok(ToAggregator::Proof(proof)) => self.proofs.push(proof),
                // The simulated path has no delay, so the echo arrives at once.
                Ok(ToAggregator::Echo { bytes, .. }) => {
                    self.sending.on_message(&ToAgent::Echo { bytes }, self.now());
                }
                other => panic!("{other:?} was sent"),
            },
        }
    }

    fn perform(&mut self, action: Action) {
        let (now, reason) = (self.now(), "the disk is full".to_owned());
        let notice = match action {
            Action::Append { batches, .. }
                if self.spool_is_broken || self.rejects_batches && !batches.is_empty() =>
            {
                self.sending.on_append_failed(reason, now)
            }
            Action::Load { .. } if self.spool_is_broken => self.sending.on_load_failed(reason, now),
            Action::Delete { .. } if self.spool_is_broken => self.sending.on_delete_failed(reason, now),
            Action::Renew { .. } if self.spool_is_broken => self.sending.on_renew_failed(reason, now),
            Action::Append { batches, totals } => {
                self.file.append(batches, totals);
                self.sending.on_appended(now)
            }
            Action::Load { from, bytes } => self.sending.on_loaded(self.file.load(from, bytes), now),
            Action::Delete { through, chain } => {
                self.file.delete(through, chain);
                self.sending.on_deleted();
                None
            }
            Action::Renew { stream, previous_stream, first, events_before_first } => {
                self.file.events_before_first = Some(events_before_first);
                assert_eq!((previous_stream, first), (self.file.stream, self.file.state().oldest));
                (self.file.stream, self.file.previous_stream, self.file.first) =
                    (stream, Some(previous_stream), first);
                self.sending.on_renewed(now);
                None
            }
            Action::Send(_) => unreachable!("sending is not an action of the spool"),
        };
        self.notices.extend(notice);
    }

    fn offer(&mut self, events: usize) {
        for n in 0..events {
            self.sending.offer(&incident(&format!("event {n}")), self.now());
        }
        self.settle();
    }

    /// Offers events, one per batch, and closes the last batch.
    fn offer_batches(&mut self, batches: usize) {
        self.offer(batches);
        self.advance_ms(self.config.batch_age.nanos() / 1_000_000);
    }

    fn advance_ms(&mut self, millis: i64) {
        self.millis += millis;
        self.sending.tick(self.now());
        self.settle();
    }

    fn connect(&mut self) {
        self.sending.on_connected(self.now().mono);
        self.settle();
    }

    fn receive(&mut self, message: &ToAgent) {
        let notice = self.sending.on_message(message, self.now());
        self.notices.extend(notice);
        self.settle();
    }

    fn welcome(&mut self, stored: u64, chain: Option<ChainHash>) {
        self.welcome_with_process(stored, chain, None);
    }

    /// Delivers a welcome that states that `process` sent the last stored batch.
    fn welcome_with_process(&mut self, stored: u64, chain: Option<ChainHash>, process: Option<u64>) {
        let (aggregator, stream) = ("base".parse().expect("a name"), self.stream());
        self.receive(&ToAgent::Welcome { aggregator, stream, stored, chain, process, window: 100 });
    }

    fn ack(&mut self, through: u64) {
        let stream = self.stream();
        self.receive(&ToAgent::Ack { stream, through, window: 100 });
    }

    /// Returns the stream of the last hello.
    fn stream(&self) -> StreamId {
        self.hellos.last().map_or(self.file.stream, |hello| hello.stream)
    }

    /// Returns the numbers of the batches that were sent since the last call.
    fn take_sent_numbers(&mut self) -> Vec<u64> {
        self.sent.drain(..).map(|head| head.number).collect()
    }

    /// Returns the numbers of events by state, which must add up.
    fn accounting(&self) -> Accounting {
        let accounting = self.sending.accounting();
        assert_eq!(
            accounting.produced,
            accounting.stored + accounting.waiting + accounting.dropped,
            "{accounting:?}"
        );
        assert!(
            accounting.stored <= accounting.spooled && accounting.spooled <= accounting.produced,
            "{accounting:?}"
        );
        accounting
    }

    /// Acknowledges sent batches until no further batch is sent. Returns the numbers of the sent batches.
    fn deliver(&mut self) -> Vec<u64> {
        let mut delivered: Vec<u64> = Vec::new();
        loop {
            let numbers = self.take_sent_numbers();
            let Some(last) = numbers.last() else { return delivered };
            let last = *last;
            delivered.extend(numbers);
            self.ack(last);
        }
    }

    /// Returns the chain hash of a batch in the file.
    fn chain(&self, number: u64) -> Option<ChainHash> {
        self.file.batches.get(&number).map(|batch| batch.chain)
    }

    /// Returns the number of requested actions for which `is_counted` is `true`.
    fn count_actions(&self, is_counted: impl Fn(&Action) -> bool) -> usize {
        self.actions.iter().filter(|action| is_counted(action)).count()
    }
}
