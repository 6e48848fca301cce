//! Who may speak.

use peernet_clock::MonoTime;

use super::super::codec::MAX_MESSAGE_BYTES;
use super::super::{PROTOCOL, batch_weight};
use super::progress::LAST_BATCH;
use super::{Hello, Mark, Receiving, StreamId};
use crate::{HostId, Slug};

/// A host that said hello.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Session {
    name: Slug,
    pub(super) process: u64,
    pub(super) stream: StreamId,
    pub(super) heard: MonoTime,
    /// What a batch of the usual length counts in a window, by its word; what is longer than a message counts as a
    /// message.
    pub(super) batch_bytes: u64,
    /// Another process that wants to be this host, and when it first said so.
    challenger: Option<(u64, MonoTime)>,
}

impl Session {
    pub(super) fn of(hello: &Hello, now: MonoTime) -> Self {
        Self {
            name: hello.host.name.clone(),
            process: hello.process,
            stream: hello.stream,
            heard: now,
            batch_bytes: batch_weight(MAX_MESSAGE_BYTES.min(hello.batch_bytes as usize)),
            challenger: None,
        }
    }
}

/// Whether a host gets in.
pub(super) enum Admission {
    Granted,
    Refused(String),
    /// It shows by the next hello.
    Later,
}

impl Receiving {
    pub(super) fn admission(&mut self, hello: &Hello, mark: Option<Mark>, now: MonoTime) -> Admission {
        match self.objection(hello, mark, now) {
            Some(reason) => Admission::Refused(reason),
            None => self.challenge(hello, now),
        }
    }

    /// What speaks against a hello whoever is connected under its host id.
    fn objection(&self, hello: &Hello, mark: Option<Mark>, now: MonoTime) -> Option<String> {
        let (host, name) = (hello.host.id, &hello.host.name);
        if hello.protocol != PROTOCOL {
            return Some(format!(
                "the agent speaks version {} of the event stream, the aggregator version {PROTOCOL}: install the \
                 same release on both",
                hello.protocol
            ));
        }
        let (first, oldest) = (hello.first, hello.oldest);
        if first == 0 || oldest < first || oldest > LAST_BATCH {
            return Some(format!(
                "a stream that begins with batch {first} and of which {oldest} is the oldest cannot be: the spool of \
                 this agent is damaged, delete it"
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
        let here = self.streams.get(&hello.stream).map(|progress| progress.host);
        let owner = here.or(mark.map(|mark| mark.host)).filter(|owner| *owner != host)?;
        Some(format!(
            "the spool of this agent belongs to the host with the id {owner}: delete the one that was copied"
        ))
    }

    /// A process takes over from another that is silent. While the other is heard they are one copied host.
    fn challenge(&mut self, hello: &Hello, now: MonoTime) -> Admission {
        let host: HostId = hello.host.id;
        let silence = self.config.silence;
        let other = self.hosts.get_mut(&host).filter(|session| session.process != hello.process);
        let Some(session) = other.filter(|session| now - session.heard <= silence) else {
            return Admission::Granted;
        };
        match session.challenger {
            Some((process, since)) if process == hello.process && session.heard > since => {
                session.challenger = None;
                return Admission::Refused(format!(
                    "another agent with the host id {host} is running: delete the state directory of the one that \
                     was copied, so that it gets a host id of its own"
                ));
            }
            Some((process, _)) if process == hello.process => {}
            _ => session.challenger = Some((hello.process, now)),
        }
        Admission::Later
    }
}
