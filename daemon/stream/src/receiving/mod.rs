//! The aggregator's end of the event stream: sessions of hosts, and the next batch of each stream.

mod admission;
mod challenges;
mod deferred;
mod parts;
mod progress;

use std::collections::BTreeMap;

use bytes::Bytes;
use peernet_clock::{MonoTime, Span};

use self::admission::{Admission, Session};
pub use self::challenges::{Challenges, ProofResult};
use self::deferred::DeferredStreams;
use self::parts::PartAssembler;
use self::progress::Progress;
use super::codec::Part;
use super::{BatchHead, ChainHash, Hello, StreamId, ToAgent};
use peernet_logger::{HostId, Slug};

/// Maximum number of streams of one host with batches that are accepted and not stored: the current stream and the
/// host's earlier streams.
const MAX_UNSTORED_STREAMS: usize = 8;

/// Configuration of the receiving end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReceivingConfig {
    /// Name of the aggregator's own host.
    pub aggregator: Slug,
    /// Silence of an agent after which another process may take over its host id: the time of three live updates.
    pub process_timeout: Span,
    /// Silence of a host after which another host may take over its name.
    pub name_timeout: Span,
    /// Maximum number of bytes of batches in flight, over all agents. It limits the aggregator's memory. Each agent is
    /// allowed at least one batch.
    pub budget_bytes: u64,
    /// Largest window of one agent, in batches of the length that its hello states.
    pub max_window: u32,
}

impl ReceivingConfig {
    /// Creates a configuration with the default times and limits.
    pub const fn new(aggregator: Slug) -> Self {
        Self {
            aggregator,
            process_timeout: Span::from_millis(750),
            name_timeout: Span::from_seconds(10),
            budget_bytes: 64 << 20,
            max_window: 8,
        }
    }
}

/// The mark of a stream: the position up to which the stream's batches are stored. The mark is written in the
/// transaction that stores the batches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HighWaterMark {
    /// Host that the stream belongs to.
    pub host: HostId,
    /// Number up to which all batches are stored.
    pub stored: u64,
    /// Chain hash of the last stored batch.
    pub chain: ChainHash,
    /// Process that sent the last stored batch; `None` if it is unknown.
    pub process: Option<u64>,
    /// Number of events in all batches of the spool up to the last stored batch; `None` if it is unknown, because an
    /// earlier version wrote the mark.
    pub events: Option<u64>,
}

impl From<BatchHead> for HighWaterMark {
    /// Returns the mark of the stream after this batch is stored.
    fn from(head: BatchHead) -> Self {
        Self {
            host: head.host,
            stored: head.number,
            chain: head.chain,
            process: Some(head.process),
            events: Some(head.events_through()),
        }
    }
}

impl From<MissingBatches> for HighWaterMark {
    /// Returns the mark of the stream after the gap in place of these batches is stored.
    fn from(missing: MissingBatches) -> Self {
        let MissingBatches { host, through, chain, process, events_through, .. } = missing;
        Self { host, stored: through, chain, process: Some(process), events: Some(events_through) }
    }
}

/// State of the database for a host that sends a hello, including batches that are about to be stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StreamRecord {
    /// Mark of the hello's stream; `None` if no batch of the stream is stored.
    pub mark: Option<HighWaterMark>,
    /// `true` if the host used the hello's stream before.
    pub was_used: bool,
    /// Stream that the host used most recently; `None` for a new host.
    pub last_stream: Option<StreamId>,
    /// Mark of the stream that the hello's stream continues; `None` if there is no such stream or none of its batches
    /// is stored.
    pub previous_mark: Option<HighWaterMark>,
    /// Position in the order in which hosts were first stored: smaller for older hosts; `None` for a host of which
    /// nothing is stored.
    pub seniority: Option<u64>,
}

/// Result of a hello.
#[derive(Clone, Debug, PartialEq)]
pub enum HelloResult {
    /// The host has a session now.
    Welcome {
        /// Message to be sent.
        reply: ToAgent,
        /// Batches of this stream that neither end has any more. The caller stores a gap in place of these batches,
        /// together with the mark of the last of them.
        missing: Option<MissingBatches>,
        /// Previous stream of this host, if the new stream does not continue the previous stream: the spool was deleted
        /// or replaced, and the events that the old spool still held are lost. The caller stores a gap of unknown
        /// count.
        replaced: Option<StreamId>,
        /// Batches that are missing in this database, of the stream that this stream continues. The database is an
        /// older copy of the database that stored these batches. The caller stores a gap. The mark of the previous
        /// stream does not change, because another copy of the spool may still hold the batches.
        missing_previous: Option<MissingPreviousBatches>,
        /// Another host that was connected with the same name. Its session ended, because this host has been stored for
        /// longer.
        displaced: Option<HostId>,
    },
    /// The hello was refused.
    Refused {
        /// Message to be sent.
        reply: ToAgent,
        /// Reason in the message.
        reason: String,
    },
    /// No decision yet; nothing is to be sent, and the agent's next hello is decided. There are three causes:
    ///
    /// - Another process of the same host was active recently. If the other process has ended, the next hello of this
    ///   process is accepted. Otherwise the other process sends something before the next hello, and the next hello is
    ///   refused.
    /// - An earlier process sent batches of the stream that are not stored yet.
    /// - Too many batches of the host are not stored yet.
    Wait,
}

/// Batches of a stream that the agent no longer holds and that were never stored in this database.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MissingBatches {
    /// Host that the stream belongs to.
    pub host: HostId,
    /// Stream of the batches.
    pub stream: StreamId,
    /// Number of the first batch.
    pub from: u64,
    /// Number of the last batch.
    pub through: u64,
    /// Chain hash of the last batch, as stated by the agent.
    pub chain: ChainHash,
    /// Process that stated that it no longer holds the batches.
    pub process: u64,
    /// Number of events in the batches; `None` if it is unknown.
    pub events: Option<u64>,
    /// Number of events in all batches of the spool up to the last of these batches.
    pub events_through: u64,
}

/// Batches of a previous stream that are missing in this database.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MissingPreviousBatches {
    /// Stream of the batches.
    pub stream: StreamId,
    /// Number of the first batch; 1 if nothing of the stream is known.
    pub from: u64,
    /// Number of the last batch: the batch before the first batch of the new stream. If that batch is stored, and the
    /// only missing batches are those that a killed process sent from memory, `through` is `from`.
    pub through: u64,
    /// Number of events in the missing batches, including those that a killed process sent from memory; `None` if it is
    /// unknown.
    pub events: Option<u64>,
}

/// Result of the arrival of a batch.
#[derive(Clone, Debug, PartialEq)]
pub enum Arrival {
    /// The batch is the next batch of its stream. Store it, and then call [`Receiving::handle_stored`].
    Accept,
    /// The batch is the next batch of its stream, but its bytes did not match its hash in several attempts. Quarantine
    /// the batch unchanged, like a batch that cannot be decoded, and mark it as stored.
    AcceptDamaged,
    /// The batch is already stored. The acknowledgement was lost and is to be sent again.
    Duplicate(ToAgent),
    /// The batch is already accepted, and about to be stored.
    Pending,
    /// Batches before this batch are missing, or this batch was damaged in transit. The message, if any, requests the
    /// missing or damaged batches again.
    Rejected(Option<ToAgent>),
    /// The process has no session with the batch's stream, or the batch contradicts accepted batches. The message
    /// requests a hello.
    Unknown(ToAgent),
}

/// State machine of the aggregator's end of the event stream, without I/O.
///
/// A batch is *accepted* when it is handed to the writer, and *stored* when the transaction with the batch and the
/// stream's mark is on disk. Accepted batches are known in memory only, until the process ends; marks come from the
/// database.
///
/// The memory of this state machine is bounded: it holds a session for each recently active host, and for each stream
/// the chain hashes of the batches that are accepted and not stored. The number of these batches is at most a little
/// more than twice [`MAX_IN_FLIGHT_BATCHES`](super::MAX_IN_FLIGHT_BATCHES).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Receiving {
    config: ReceivingConfig,
    hosts: BTreeMap<HostId, Session>,
    streams: BTreeMap<StreamId, Progress>,
    deferred: DeferredStreams,
    parts: PartAssembler,
}

impl Receiving {
    /// Creates a receiving end without sessions.
    pub const fn new(config: ReceivingConfig) -> Self {
        Self {
            hosts: BTreeMap::new(),
            streams: BTreeMap::new(),
            deferred: DeferredStreams::new(),
            parts: PartAssembler::new(config.budget_bytes),
            config,
        }
    }

    /// Removes all sessions and accepted batches after the marks have changed. Every agent must send a hello again.
    pub fn forget_sessions(&mut self) {
        // The sessions were decided with marks that are no longer valid, and the writer drops the accepted batches.
        *self = Self::new(self.config.clone());
    }

    /// Returns the reason to refuse a hello whose agent has no version in common with this aggregator; `None` for any
    /// other hello. Such a hello is refused at once, and every other hello is challenged first ([`Challenges`]).
    pub fn version_refusal(hello: &Hello) -> Option<String> {
        admission::version_mismatch(hello)
    }

    /// Decides about a hello whose host has proven its identity. Missing batches are reported once, and not again for
    /// later hellos of the host with the same stream.
    ///
    /// The mark takes precedence over the agent's statement. Batches after the mark that the agent does not hold are
    /// [`MissingBatches`], even if the agent states that its stream began later than the mark. A hello whose oldest
    /// held batch is before the stream's first batch is refused.
    pub fn handle_hello(&mut self, hello: &Hello, record: StreamRecord, now: MonoTime) -> HelloResult {
        let StreamRecord { mark, last_stream, seniority, .. } = record;
        let (host, stream) = (hello.host.id, hello.stream);
        match self.admission(hello, record, now) {
            Admission::Granted => {}
            Admission::Refused(reason) => {
                return HelloResult::Refused { reply: ToAgent::Refused { reason: reason.clone() }, reason };
            }
            Admission::Later => return HelloResult::Wait,
        }
        // The welcome states the last stored batch. Batches from an earlier process of the host are stored first, so
        // that this statement stays true.
        let has_unstored = |progress: &Progress| progress.has_unstored_from_other_process(hello.process);
        if self.has_too_many_unstored(host, stream) || self.streams.get(&stream).is_some_and(has_unstored) {
            return HelloResult::Wait;
        }
        // A stream is new only at its first hello. A gap is therefore recorded once, even if the agent reconnects
        // often.
        let is_new = !record.was_used && mark.is_none() && !self.streams.contains_key(&stream);
        let replaced =
            last_stream.filter(|last| is_new && *last != stream && Some(*last) != hello.previous_stream);
        let missing_previous = hello.previous_stream.filter(|_| is_new).and_then(|previous_stream| {
            let from = record.previous_mark.map_or(1, |mark| mark.stored.saturating_add(1));
            let through = hello.first - 1;
            let stored = record.previous_mark.map_or(Some(0), |mark| mark.events);
            let events =
                hello.events_before_first.zip(stored).map(|(sent, stored)| sent.saturating_sub(stored));
            // A process that died may have sent batches from memory, after the last batch in its spool. A newer copy of
            // this database may have stored these batches.
            let is_missing = from <= through || events.is_some_and(|events| events > 0);
            is_missing.then_some(MissingPreviousBatches {
                stream: previous_stream,
                from,
                through: through.max(from),
                events,
            })
        });
        let displaced = self.take_back_name(hello, now);
        let replaced_session = self.hosts.insert(host, Session::new(hello, seniority, now));
        // A new process may hold other batches with the same numbers. Batches that an earlier process sent are
        // therefore not confirmed for the new process.
        let is_same_process = replaced_session
            .as_ref()
            .is_some_and(|session| session.process == hello.process && session.stream == stream);
        let progress = self.streams.entry(stream).or_insert_with(|| Progress::new(hello, mark));
        let missing = progress.handle_hello(hello, mark, is_same_process);
        let (stored, last_mark) = progress.stored();
        self.deferred.remove(stream);
        self.parts.remove(host);
        if let Some(replaced_session) = replaced_session {
            self.forget_if_stored(replaced_session.stream);
        }
        let aggregator = self.config.aggregator.clone();
        let (chain, process) = (last_mark.map(|mark| mark.chain), last_mark.and_then(|mark| mark.process));
        let window = self.window(host);
        let reply = ToAgent::Welcome { aggregator, stream, stored, chain, process, window };
        HelloResult::Welcome { reply, missing, replaced, missing_previous, displaced }
    }

    /// Returns whether a hello adds nothing to the session of its process: the session has the same stream, and the agent
    /// holds all batches after the accepted batches. The welcome to such a hello reports nothing that is to be stored.
    pub fn is_repeated_hello(&self, hello: &Hello) -> bool {
        let has_session = self
            .hosts
            .get(&hello.host.id)
            .is_some_and(|session| (session.process, session.stream) == (hello.process, hello.stream));
        let progress = self.streams.get(&hello.stream).filter(|_| has_session);
        progress.is_some_and(|progress| progress.has_all_before(hello.oldest))
    }

    /// Returns whether the host must wait for the writer, because its stream has too many batches that are not stored,
    /// or because the host has too many other streams in memory.
    fn has_too_many_unstored(&self, host: HostId, stream: StreamId) -> bool {
        let is_full = self.streams.get(&stream).is_some_and(Progress::is_full);
        // A stream that no host sends any more stays in memory only until its batches are stored.
        let other_streams =
            self.streams.iter().filter(|(id, progress)| progress.host == host && **id != stream);
        is_full || other_streams.count() >= MAX_UNSTORED_STREAMS
    }

    /// Decides about a batch. `is_intact` tells whether its bytes match its hash ([`super::codec::decode_batch_body`]).
    /// An intact batch is accepted even if it cannot be decoded; it is quarantined later.
    pub fn handle_batch(&mut self, head: &BatchHead, is_intact: bool, now: MonoTime) -> Arrival {
        let window = self.window(head.host);
        let session = self.hosts.get_mut(&head.host);
        let session =
            // A host that changed its stream or process must not add batches to the old stream.
            session.filter(|session| session.stream == head.stream && session.process == head.process);
        let (Some(session), Some(progress)) = (session, self.streams.get_mut(&head.stream)) else {
            return Arrival::Unknown(ToAgent::Unknown);
        };
        session.last_message_at = now;
        progress.handle_batch(head, is_intact, window)
    }

    /// Adds a part of a batch from a host with a session. Returns the frame of the batch when it is complete.
    pub fn handle_part(&mut self, part: &Part, now: MonoTime) -> Option<Bytes> {
        self.hosts.get_mut(&part.host)?.last_message_at = now;
        self.parts.add(part)
    }

    /// Returns the answer to a request for an echo ([`ToAggregator::Echo`](super::ToAggregator::Echo)). The answer is
    /// to be sent at once.
    pub fn handle_echo(&mut self, host: HostId, bytes: u64, now: MonoTime) -> ToAgent {
        // A host without a session gets a request for a hello instead of the echo.
        self.handle_live(host, now).unwrap_or(ToAgent::Echo { bytes })
    }

    /// Records that the queue had no capacity for a batch of the stream, which `host` sent. The batch counts as not
    /// received, and [`request_deferred`](Self::request_deferred) requests it again.
    pub fn defer_batch(&mut self, host: HostId, stream: StreamId) {
        // The head of a batch may name any stream. No host can cause a request to another host.
        if self.current_sender(stream) != Some(host) {
            return;
        }
        if let Some(progress) = self.streams.get_mut(&stream) {
            // The batch may have been the answer to a request. While the request is recorded, the batch would not be
            // requested again.
            progress.forget_request();
            self.deferred.push(stream);
        }
    }

    /// Returns requests for deferred batches when the queue has capacity for `batches` batches: one request per stream,
    /// beginning with the stream that has waited longest.
    pub fn request_deferred(&mut self, batches: usize) -> Vec<(HostId, ToAgent)> {
        let mut requested = Vec::new();
        while requested.len() < batches
            && let Some(stream) = self.deferred.pop()
        {
            let Some(host) = self.current_sender(stream) else { continue };
            let request = self.streams.get_mut(&stream).and_then(|progress| progress.request_next(stream));
            requested.extend(request.map(|request| (host, request)));
        }
        requested
    }

    /// Records the arrival of a live update. Returns the answer to a host without a session; `None` for any other host.
    pub fn handle_live(&mut self, host: HostId, now: MonoTime) -> Option<ToAgent> {
        match self.hosts.get_mut(&host) {
            Some(session) => {
                session.last_message_at = now;
                None
            }
            None => Some(ToAgent::Unknown),
        }
    }

    /// Ends the session of an agent that stops. Other agents may use its name and its host id at once.
    pub fn handle_goodbye(&mut self, host: HostId) {
        self.parts.remove(host);
        if let Some(session) = self.hosts.remove(&host) {
            self.deferred.remove(session.stream);
            self.forget_if_stored(session.stream);
        }
    }

    /// Records that the mark of a stream is on disk. Returns the acknowledgement and the host that receives it.
    ///
    /// Only batches that the connected agent is known to hold are acknowledged. Batches that an earlier process sent
    /// may differ from the connected agent's batches with the same numbers, and an acknowledgement makes the agent
    /// delete its batches.
    pub fn handle_stored(&mut self, stream: StreamId, mark: HighWaterMark) -> Option<(HostId, ToAgent)> {
        let window = self.window(mark.host);
        let reply = self.streams.get_mut(&stream)?.record_stored(stream, mark, window);
        let receiver = self.current_sender(stream);
        self.forget_if_stored(stream);
        receiver.zip(reply)
    }

    /// Records that storing failed: batches that are accepted and not stored count as not received. The writer must
    /// drop its batches of the stream, or a later batch would be stored before the failed batch. Returns the request to
    /// send the batches again, and the host that receives the request.
    pub fn handle_failed_store(&mut self, stream: StreamId) -> Option<(HostId, ToAgent)> {
        let request = self.streams.get_mut(&stream)?.record_storing_failure(stream);
        let receiver = self.current_sender(stream);
        self.forget_if_stored(stream);
        receiver.map(|host| (host, request))
    }

    /// Returns whether the host has a session and its last message is at most `max_silence` old.
    pub fn is_alive(&self, host: HostId, max_silence: Span, now: MonoTime) -> bool {
        self.hosts.get(&host).is_some_and(|session| now - session.last_message_at <= max_silence)
    }

    /// Ends sessions of hosts that were silent for longer than `silence`. Such a host is asked for a hello when it
    /// returns.
    pub fn forget_silent(&mut self, silence: Span, now: MonoTime) {
        let silent = self.hosts.iter().filter(|(_, session)| now - session.last_message_at > silence);
        let silent_hosts: Vec<HostId> = silent.map(|(host, _)| *host).collect();
        silent_hosts.into_iter().for_each(|host| self.handle_goodbye(host));
    }

    /// Returns the window of a host, counted in batches of the length that the host's hello states.
    ///
    /// The window depends on the number of connected hosts and on the host's own batch length, not on the batch lengths
    /// of other hosts: a host that has or states large batches does not slow down the other hosts.
    fn window(&self, host: HostId) -> u32 {
        let batch_weight = self.hosts.get(&host).map_or(1, |session| session.batch_weight);
        // Each connected host gets an equal share of the memory, so that all hosts together stay within the budget.
        let batches = self.config.budget_bytes / (self.hosts.len() as u64).max(1) / batch_weight;
        u32::try_from(batches).unwrap_or(u32::MAX).clamp(1, self.config.max_window.max(1))
    }

    /// Returns the host that currently sends a stream.
    fn current_sender(&self, stream: StreamId) -> Option<HostId> {
        let host = self.streams.get(&stream)?.host;
        self.hosts.get(&host).is_some_and(|session| session.stream == stream).then_some(host)
    }

    /// Removes a stream from memory if no host sends the stream and all its accepted batches are stored. The stream's
    /// mark remains in the database.
    fn forget_if_stored(&mut self, stream: StreamId) {
        if self.current_sender(stream).is_none() {
            self.deferred.remove(stream);
            if self.streams.get(&stream).is_some_and(Progress::is_all_stored) {
                self.streams.remove(&stream);
            }
        }
    }
}
