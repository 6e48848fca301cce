//! The aggregator's end of the event stream: who may speak, and which batch is next.

use std::collections::HashMap;

use peernet_clock::{MonoTime, Span};

use super::{Hello, PROTOCOL, StreamId, ToAgent};
use crate::{HostId, Slug};

/// How agents are told apart.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReceivingConfig {
    /// Name of the aggregator's own host.
    pub aggregator: Slug,
    /// An agent that was silent for so long no longer defends its host id: three of its live updates.
    pub silence: Span,
    /// An agent that was silent for so long no longer holds its name.
    pub name_held: Span,
}

impl ReceivingConfig {
    /// The usual times.
    pub const fn new(aggregator: Slug) -> Self {
        Self { aggregator, silence: Span::from_millis(750), name_held: Span::from_seconds(10) }
    }
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
    },
    /// It is not.
    Refused {
        /// To be sent.
        reply: ToAgent,
        /// What the reply says.
        reason: String,
    },
    /// Another process of the same host was heard a moment ago. If it is dead, the next hello of this one gets in;
    /// if it lives, it shows by then. Nothing to be sent.
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
}

/// What becomes of a batch.
#[derive(Clone, Debug, PartialEq)]
pub enum Arrival {
    /// It is the next: store it, then call [`Receiving::stored`].
    Accept,
    /// It is stored already; the acknowledgement was lost and is to be sent again.
    Duplicate(ToAgent),
    /// It was accepted and is about to be stored.
    Pending,
    /// Batches before it are missing; to be asked for, unless that was done.
    Hole(Option<ToAgent>),
    /// Nobody with that host id and stream has said hello here; to be told so.
    Unknown(ToAgent),
}

/// The aggregator's end of the event stream, without I/O: told what came, it says what becomes of it.
///
/// A batch is *accepted* when it is handed to the writer and *stored* when the transaction that holds it and the
/// stream's mark is on disk. Acceptance is in memory and ends with the process; marks are what the database says.
#[derive(Debug)]
pub struct Receiving {
    config: ReceivingConfig,
    hosts: HashMap<HostId, Session>,
    streams: HashMap<StreamId, Marks>,
}

#[derive(Debug)]
struct Session {
    name: Slug,
    process: u64,
    stream: StreamId,
    heard: MonoTime,
    /// Another process that wants to be this host, and when it first said so.
    challenger: Option<(u64, MonoTime)>,
}

#[derive(Debug)]
struct Marks {
    host: HostId,
    accepted: u64,
    stored: u64,
    /// The number from which batches were asked for again, until the first of them comes.
    asked: Option<u64>,
}

impl Receiving {
    /// The receiving end, knowing nobody.
    pub fn new(config: ReceivingConfig) -> Self {
        Self { config, hosts: HashMap::new(), streams: HashMap::new() }
    }

    /// A hello came; `stored` is the mark of its stream in the database, 0 when there is none.
    pub fn hello(&mut self, hello: &Hello, stored: u64, now: MonoTime) -> Greeting {
        let host = hello.host.id;
        if let Some(reason) = self.objection(hello, now) {
            return Greeting::Refused { reply: ToAgent::Refused { reason: reason.clone() }, reason };
        }
        if let Some(session) = self.hosts.get_mut(&host)
            && session.process != hello.process
            && now - session.heard <= self.config.silence
        {
            match session.challenger {
                Some((process, since)) if process == hello.process && session.heard > since => {
                    session.challenger = None;
                    let reason = format!(
                        "another agent with the host id {host} is running: delete the state directory of the one \
                         that was copied, so that it gets a host id of its own"
                    );
                    return Greeting::Refused { reply: ToAgent::Refused { reason: reason.clone() }, reason };
                }
                Some((process, _)) if process == hello.process => {}
                _ => session.challenger = Some((hello.process, now)),
            }
            return Greeting::Wait;
        }
        let (name, process, stream) = (hello.host.name.clone(), hello.process, hello.stream);
        let left = self.hosts.insert(host, Session { name, process, stream, heard: now, challenger: None });
        let fresh = Marks { host, accepted: stored, stored, asked: None };
        let marks = self.streams.entry(stream).or_insert(fresh);
        marks.stored = marks.stored.max(stored);
        marks.accepted = marks.accepted.max(stored);
        marks.asked = None;
        let missing = (hello.oldest > marks.accepted.saturating_add(1)).then(|| {
            let from = marks.accepted + 1;
            marks.accepted = hello.oldest - 1;
            Missing { host, stream, from, through: marks.accepted }
        });
        let reply =
            ToAgent::Welcome { aggregator: self.config.aggregator.clone(), stream, stored: marks.stored };
        if let Some(left) = left {
            self.forget_if_settled(left.stream);
        }
        Greeting::Welcome { reply, missing }
    }

    /// What speaks against a hello whoever is connected.
    fn objection(&self, hello: &Hello, now: MonoTime) -> Option<String> {
        let (host, name) = (hello.host.id, &hello.host.name);
        if hello.protocol != PROTOCOL {
            return Some(format!(
                "the agent speaks version {} of the event stream, the aggregator version {PROTOCOL}: install the \
                 same release on both",
                hello.protocol
            ));
        }
        let named = self.hosts.iter().find(|(other, session)| {
            **other != host && session.name == *name && now - session.heard <= self.config.name_held
        });
        if let Some((other, _)) = named {
            return Some(format!(
                "the name {name} is taken by the host with the id {other}: give one of the two another name"
            ));
        }
        let owner = self.streams.get(&hello.stream).map(|marks| marks.host).filter(|owner| *owner != host)?;
        Some(format!(
            "the spool of this agent belongs to the host with the id {owner}: delete the one that was copied"
        ))
    }

    /// A batch came. An unreadable one is told of as well ([`super::codec::batch_head`]); when accepted it is
    /// stored as a gap.
    pub fn batch(&mut self, host: HostId, stream: StreamId, number: u64, now: MonoTime) -> Arrival {
        let session = self.hosts.get_mut(&host).filter(|session| session.stream == stream);
        let (Some(session), Some(marks)) = (session, self.streams.get_mut(&stream)) else {
            return Arrival::Unknown(ToAgent::Unknown);
        };
        session.heard = now;
        if number <= marks.stored {
            Arrival::Duplicate(ToAgent::Ack { stream, through: marks.stored })
        } else if number <= marks.accepted {
            Arrival::Pending
        } else if number == marks.accepted + 1 {
            (marks.accepted, marks.asked) = (number, None);
            Arrival::Accept
        } else {
            let from = marks.accepted + 1;
            let reply = (marks.asked != Some(from)).then_some(ToAgent::Resend { stream, from });
            marks.asked = Some(from);
            Arrival::Hole(reply)
        }
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
        if let Some(session) = self.hosts.remove(&host) {
            self.forget_if_settled(session.stream);
        }
    }

    /// The mark of a stream is on disk. Returns the acknowledgement and whom to send it to.
    pub fn stored(&mut self, stream: StreamId, through: u64) -> Option<(HostId, ToAgent)> {
        let marks = self.streams.get_mut(&stream)?;
        marks.stored = marks.stored.max(through);
        marks.accepted = marks.accepted.max(through);
        let host = marks.host;
        let listening = self.hosts.get(&host).is_some_and(|session| session.stream == stream);
        self.forget_if_settled(stream);
        listening.then_some((host, ToAgent::Ack { stream, through }))
    }

    /// Storing failed: everything accepted and not stored counts as never come. The writer must drop what it still
    /// holds of the stream, or a later batch would be stored before the one that failed. Returns the request to send
    /// it again and whom to send it to.
    pub fn failed(&mut self, stream: StreamId) -> Option<(HostId, ToAgent)> {
        let marks = self.streams.get_mut(&stream)?;
        marks.accepted = marks.stored;
        let from = marks.stored + 1;
        marks.asked = Some(from);
        let host = marks.host;
        let listening = self.hosts.get(&host).is_some_and(|session| session.stream == stream);
        self.forget_if_settled(stream);
        listening.then_some((host, ToAgent::Resend { stream, from }))
    }

    /// Whether the host said hello and was heard within the last `within`.
    pub fn is_alive(&self, host: HostId, within: Span, now: MonoTime) -> bool {
        self.hosts.get(&host).is_some_and(|session| now - session.heard <= within)
    }

    /// Forgets hosts that were silent for longer than `silence`; they are told to say hello when they come back.
    pub fn forget_silent(&mut self, silence: Span, now: MonoTime) {
        let gone: Vec<HostId> = self
            .hosts
            .iter()
            .filter(|(_, session)| now - session.heard > silence)
            .map(|(host, _)| *host)
            .collect();
        gone.into_iter().for_each(|host| self.goodbye(host));
    }

    /// A stream that nobody sends and nothing waits of needs no place in memory: its mark is on disk.
    fn forget_if_settled(&mut self, stream: StreamId) {
        let in_use = self.hosts.values().any(|session| session.stream == stream);
        if !in_use && self.streams.get(&stream).is_some_and(|marks| marks.accepted == marks.stored) {
            self.streams.remove(&stream);
        }
    }
}
