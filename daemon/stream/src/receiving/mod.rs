//! The aggregator's end of the event stream: who may speak, and which batch is next.

mod admission;
mod challenges;
mod deferred;
mod parts;
mod progress;

use std::collections::BTreeMap;

use bytes::Bytes;
use peernet_clock::{MonoTime, Span};

use self::admission::{Admission, Session};
pub use self::challenges::{Challenges, Proven};
use self::deferred::Deferred;
use self::parts::Parts;
use self::progress::Progress;
use super::codec::Part;
use super::{BatchHead, Chain, Hello, StreamId, ToAgent};
use peernet_logger::{HostId, Slug};

/// Streams of one host that are not stored as far as they were accepted, at most: one, and those it left a moment ago.
const MOST_UNSETTLED: usize = 8;

/// How agents are told apart.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReceivingConfig {
    /// Name of the aggregator's own host.
    pub aggregator: Slug,
    /// An agent that was silent for so long no longer defends its host id: three of its live updates.
    pub silence: Span,
    /// An agent that was silent for so long no longer holds its name.
    pub name_held: Span,
    /// Bytes of batches that may be under way from all agents together, as long as each has one at least: what the
    /// aggregator is ready to hold in memory.
    pub budget_bytes: u64,
    /// What one agent may have under way, at most, in units of its batches' usual length.
    pub most_window: u32,
}

impl ReceivingConfig {
    /// The usual times.
    pub const fn new(aggregator: Slug) -> Self {
        Self {
            aggregator,
            silence: Span::from_millis(750),
            name_held: Span::from_seconds(10),
            budget_bytes: 64 << 20,
            most_window: 8,
        }
    }
}

/// How far a stream is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mark {
    /// Whose stream it is.
    pub host: HostId,
    /// All batches up to and including this number.
    pub stored: u64,
    /// Chain of that batch.
    pub chain: Chain,
    /// The process that sent it; `None` when it is not known.
    pub process: Option<u64>,
    /// Number of events in all batches of the spool up to it; `None` when it is not known, because an earlier version
    /// stored it.
    pub events: Option<u64>,
}

impl From<BatchHead> for Mark {
    /// With this batch the stream is stored up to it.
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

impl From<Missing> for Mark {
    /// With this gap the stream is stored up to its end.
    fn from(missing: Missing) -> Self {
        let Missing { host, through, chain, process, events_through, .. } = missing;
        Self { host, stored: through, chain, process: Some(process), events: Some(events_through) }
    }
}

/// What the database knows when a host says hello, or is about to know.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Known {
    /// How far the stream of the hello is stored.
    pub mark: Option<Mark>,
    /// Whether the host came with that stream before.
    pub came: bool,
    /// The stream that the host used last.
    pub last: Option<StreamId>,
    /// How far the stream is stored from which that of the hello goes on.
    pub previous: Option<Mark>,
    /// Smaller for hosts that have been stored for longer; `None` for one of which nothing is stored.
    pub seniority: Option<u64>,
}

/// What becomes of a hello.
#[derive(Clone, Debug, PartialEq)]
pub enum Greeting {
    /// The agent is in.
    Welcome {
        /// To be sent.
        reply: ToAgent,
        /// Batches that nobody has any more: to be stored as a gap together with the mark `through`.
        missing: Option<Missing>,
        /// The stream that this host sent before and that this one does not go on from: its spool was deleted or
        /// replaced, and what it still held will not come. To be stored as a gap of unknown count.
        replaced: Option<StreamId>,
        /// Batches that were stored once in the stream from which this one goes on, and are not here: the database is
        /// older than they are. To be stored as a gap; the mark of that stream stays, because another copy of the
        /// spool may still hold them.
        lacking: Option<Lacking>,
        /// Another host that used the name of this one, which has been stored for longer: it is not in any more.
        displaced: Option<HostId>,
    },
    /// It is not.
    Refused {
        /// To be sent.
        reply: ToAgent,
        /// What the reply says.
        reason: String,
    },
    /// Another process of the same host was heard a moment ago. If it is dead, the next hello of this one gets in;
    /// if it lives, it shows by then. Or too much of what the host sent waits to be stored. Nothing to be sent.
    Wait,
}

/// Batches of a stream that the agent no longer holds and that were never stored here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Missing {
    /// Whose.
    pub host: HostId,
    /// Which stream.
    pub stream: StreamId,
    /// The first.
    pub from: u64,
    /// The last.
    pub through: u64,
    /// Chain of the last, by the agent's word.
    pub chain: Chain,
    /// The process that says so.
    pub process: u64,
    /// How many events they held; `None` when it is not known.
    pub events: Option<u64>,
    /// Number of events in all batches of the spool up to the last of them.
    pub events_through: u64,
}

/// Batches of a stream that was left, of which this database knows nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lacking {
    /// Which stream.
    pub stream: StreamId,
    /// The first; 1 where nothing is known of the stream, wherever it began.
    pub from: u64,
    /// The last that is known of.
    pub through: u64,
    /// How many events they held, with those behind the last that is known of; `None` when it is not known.
    pub events: Option<u64>,
}

/// What becomes of a batch.
#[derive(Clone, Debug, PartialEq)]
pub enum Arrival {
    /// It is the next: store it, then call [`Receiving::stored`].
    Accept,
    /// It is the next, and its bytes do not match its hash however often it is sent: to be put aside as it came, like
    /// a batch that cannot be read, and to be marked as stored.
    AcceptDamaged,
    /// It is stored already; the acknowledgement was lost and is to be sent again.
    Duplicate(ToAgent),
    /// It was accepted and is about to be stored.
    Pending,
    /// Batches before it are missing, or it was damaged on its way; to be asked for, unless that was done.
    Hole(Option<ToAgent>),
    /// No such process has said hello here with that stream, or the batch contradicts what was accepted; to be told to
    /// say hello.
    Unknown(ToAgent),
}

/// The aggregator's end of the event stream, without I/O: told what came, it says what becomes of it.
///
/// A batch is *accepted* when it is handed to the writer and *stored* when the transaction that holds it and the
/// stream's mark is on disk. Acceptance is in memory and ends with the process; marks are what the database says.
///
/// What it keeps is bounded: a session for each host that was heard of late, and for each stream the chains of what is
/// accepted and not stored, of which there are little more than twice [`MOST_UNDER_WAY`](super::MOST_UNDER_WAY).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Receiving {
    config: ReceivingConfig,
    hosts: BTreeMap<HostId, Session>,
    streams: BTreeMap<StreamId, Progress>,
    deferred: Deferred,
    parts: Parts,
}

impl Receiving {
    /// The receiving end, knowing nobody.
    pub const fn new(config: ReceivingConfig) -> Self {
        Self {
            hosts: BTreeMap::new(),
            streams: BTreeMap::new(),
            deferred: Deferred::new(),
            parts: Parts::new(config.budget_bytes),
            config,
        }
    }

    /// Forgets every session and all that was accepted: the marks have changed, every agent is to say hello again.
    pub fn forget_sessions(&mut self) {
        *self = Self::new(self.config.clone());
    }

    /// What speaks against a hello before anything is proven: `None` for an agent that may be challenged
    /// ([`Challenges`]).
    pub fn refuses_version(hello: &Hello) -> Option<String> {
        admission::wrong_version(hello)
    }

    /// A hello came whose host has proven that it is who it says. What is found lacking or replaced is said when the host
    /// first comes with a stream.
    ///
    /// The mark counts, not the agent's word: batches after it that the agent does not hold are [`Missing`], also
    /// where the agent says that its stream began later than the mark. A stream whose oldest batch lies before its
    /// first is refused.
    pub fn hello(&mut self, hello: &Hello, known: Known, now: MonoTime) -> Greeting {
        let Known { mark, last, seniority, .. } = known;
        let (host, stream) = (hello.host.id, hello.stream);
        match self.admission(hello, known, now) {
            Admission::Granted => {}
            Admission::Refused(reason) => {
                return Greeting::Refused { reply: ToAgent::Refused { reason: reason.clone() }, reason };
            }
            Admission::Later => return Greeting::Wait,
        }
        // What an earlier process of the host sent is stored first, so that what the answer says of it remains true.
        let unsettled = |progress: &Progress| progress.awaits_other_than(hello.process);
        if self.has_too_much_unsettled(host, stream) || self.streams.get(&stream).is_some_and(unsettled) {
            return Greeting::Wait;
        }
        let is_new = !known.came && mark.is_none() && !self.streams.contains_key(&stream);
        let replaced = last.filter(|last| is_new && *last != stream && Some(*last) != hello.previous);
        let lacking = hello.previous.filter(|_| is_new).and_then(|previous| {
            let from = known.previous.map_or(1, |mark| mark.stored.saturating_add(1));
            let through = hello.first - 1;
            let stored = known.previous.map_or(Some(0), |mark| mark.events);
            let events =
                hello.events_before_first.zip(stored).map(|(all, stored)| all.saturating_sub(stored));
            // Batches behind the last that the spool held may have been stored from the memory of a dead process.
            let lacks = from <= through || events.is_some_and(|events| events > 0);
            lacks.then_some(Lacking { stream: previous, from, through: through.max(from), events })
        });
        let displaced = self.take_back_name(hello, now);
        let left = self.hosts.insert(host, Session::of(hello, seniority, now));
        let same = left.as_ref().is_some_and(|left| left.process == hello.process && left.stream == stream);
        let progress = self.streams.entry(stream).or_insert_with(|| Progress::new(hello, mark));
        let missing = progress.greet(hello, mark, same);
        let (stored, last) = progress.stored();
        self.deferred.remove(stream);
        self.parts.forget(host);
        if let Some(left) = left {
            self.forget_if_settled(left.stream);
        }
        let aggregator = self.config.aggregator.clone();
        let (chain, process) = (last.map(|last| last.chain), last.and_then(|last| last.process));
        let window = self.window(host);
        let reply = ToAgent::Welcome { aggregator, stream, stored, chain, process, window };
        Greeting::Welcome { reply, missing, replaced, lacking, displaced }
    }

    /// Whether a host that changes its streams waits for the writer, or its stream does.
    fn has_too_much_unsettled(&self, host: HostId, stream: StreamId) -> bool {
        let full = self.streams.get(&stream).is_some_and(Progress::is_full);
        let others = self.streams.iter().filter(|(id, progress)| progress.host == host && **id != stream);
        full || others.count() >= MOST_UNSETTLED
    }

    /// A batch came; `intact` says whether its bytes match its hash ([`super::codec::batch_body`]). One that cannot be
    /// read although it is intact is accepted as well, to be put aside by whoever reads it.
    pub fn batch(&mut self, head: &BatchHead, intact: bool, now: MonoTime) -> Arrival {
        let window = self.window(head.host);
        let session = self.hosts.get_mut(&head.host);
        let session =
            session.filter(|session| session.stream == head.stream && session.process == head.process);
        let (Some(session), Some(progress)) = (session, self.streams.get_mut(&head.stream)) else {
            return Arrival::Unknown(ToAgent::Unknown);
        };
        session.heard = now;
        progress.arrive(head, intact, window)
    }

    /// A part of a batch came from a host that said hello. Returns the frame of the batch once it is whole.
    pub fn part(&mut self, part: &Part, now: MonoTime) -> Option<Bytes> {
        self.hosts.get_mut(&part.host)?.heard = now;
        self.parts.take(part)
    }

    /// A host asks for an echo. Returns what is to be sent at once.
    pub fn echo(&mut self, host: HostId, bytes: u64, now: MonoTime) -> ToAgent {
        self.live(host, now).unwrap_or(ToAgent::Echo { bytes })
    }

    /// A batch of the stream came and there was no room for it: it counts as never come, and is asked for by
    /// [`room`](Self::room).
    pub fn deferred(&mut self, stream: StreamId) {
        if self.listener(stream).is_none() {
            return;
        }
        if let Some(progress) = self.streams.get_mut(&stream) {
            progress.forget_asking();
            self.deferred.push(stream);
        }
    }

    /// There is room for so many batches: whom to ask for what was deferred, those that wait longest first, one
    /// stream for each batch.
    pub fn room(&mut self, batches: usize) -> Vec<(HostId, ToAgent)> {
        let mut asked = Vec::new();
        while asked.len() < batches
            && let Some(stream) = self.deferred.pop()
        {
            let Some(host) = self.listener(stream) else { continue };
            let request = self.streams.get_mut(&stream).and_then(|progress| progress.ask(stream));
            asked.extend(request.map(|request| (host, request)));
        }
        asked
    }

    /// A live update came. Returns what is to be sent when its host is not known here.
    pub fn live(&mut self, host: HostId, now: MonoTime) -> Option<ToAgent> {
        match self.hosts.get_mut(&host) {
            Some(session) => {
                session.heard = now;
                None
            }
            None => Some(ToAgent::Unknown),
        }
    }

    /// An agent stops: its name and its host id are free at once.
    pub fn goodbye(&mut self, host: HostId) {
        self.parts.forget(host);
        if let Some(session) = self.hosts.remove(&host) {
            self.deferred.remove(session.stream);
            self.forget_if_settled(session.stream);
        }
    }

    /// The mark of a stream is on disk. Returns the acknowledgement and whom to send it to; or that the agent shall say
    /// hello, because it holds other batches under these numbers.
    ///
    /// Only what the connected agent is known to hold is acknowledged to it: what an earlier process sent may not be
    /// what this one has under the same number, and an acknowledgement makes it delete that.
    pub fn stored(&mut self, stream: StreamId, mark: Mark) -> Option<(HostId, ToAgent)> {
        let window = self.window(mark.host);
        let reply = self.streams.get_mut(&stream)?.settle(stream, mark, window);
        let listener = self.listener(stream);
        self.forget_if_settled(stream);
        listener.zip(reply)
    }

    /// Storing failed: everything accepted and not stored counts as never come. The writer must drop what it still
    /// holds of the stream, or a later batch would be stored before the one that failed. Returns the request to send
    /// it again and whom to send it to.
    pub fn failed(&mut self, stream: StreamId) -> Option<(HostId, ToAgent)> {
        let request = self.streams.get_mut(&stream)?.fail(stream);
        let listener = self.listener(stream);
        self.forget_if_settled(stream);
        listener.map(|host| (host, request))
    }

    /// Whether the host said hello and was heard within the last `within`.
    pub fn is_alive(&self, host: HostId, within: Span, now: MonoTime) -> bool {
        self.hosts.get(&host).is_some_and(|session| now - session.heard <= within)
    }

    /// Forgets hosts that were silent for longer than `silence`; they are told to say hello when they come back.
    pub fn forget_silent(&mut self, silence: Span, now: MonoTime) {
        let silent = self.hosts.iter().filter(|(_, session)| now - session.heard > silence);
        let gone: Vec<HostId> = silent.map(|(host, _)| *host).collect();
        gone.into_iter().for_each(|host| self.goodbye(host));
    }

    /// What the host may have under way, in units of its batches: its share of the budget. Each host's own batches
    /// count, so that one with large ones, or that says so, does not slow down the others.
    fn window(&self, host: HostId) -> u32 {
        let batch = self.hosts.get(&host).map_or(1, |session| session.batch_bytes);
        let share = self.config.budget_bytes / (self.hosts.len() as u64).max(1) / batch;
        u32::try_from(share).unwrap_or(u32::MAX).clamp(1, self.config.most_window.max(1))
    }

    /// The host that sends a stream now.
    fn listener(&self, stream: StreamId) -> Option<HostId> {
        let host = self.streams.get(&stream)?.host;
        self.hosts.get(&host).is_some_and(|session| session.stream == stream).then_some(host)
    }

    /// A stream that nobody sends and nothing waits of needs no place in memory: its mark is on disk.
    fn forget_if_settled(&mut self, stream: StreamId) {
        if self.listener(stream).is_none() {
            self.deferred.remove(stream);
            if self.streams.get(&stream).is_some_and(Progress::is_settled) {
                self.streams.remove(&stream);
            }
        }
    }
}
