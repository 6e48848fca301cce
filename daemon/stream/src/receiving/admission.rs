//! Decision about which hosts get a session.

use peernet_clock::MonoTime;

use super::super::codec::MAX_MESSAGE_BYTES;
use super::super::{STREAM_VERSIONS, batch_weight};
use super::progress::MAX_BATCH_NUMBER;
use super::{Hello, Receiving, StreamId, StreamRecord};
use peernet_logger::{HostId, Slug};

/// Returns the reason to refuse an agent that has no version in common with this aggregator.
pub(super) fn version_mismatch(hello: &Hello) -> Option<String> {
    let mismatch = STREAM_VERSIONS.highest_common(&hello.versions()).err()?;
    let agent = format!("the agent on {}", hello.host.name);
    Some(mismatch.describe("the event stream", "the aggregator", &agent))
}

/// Returns whether `host` has been in the database for longer than `other`. The arguments are the positions of the two
/// hosts ([`StreamRecord::seniority`]); `None` is a host that is not in the database.
const fn is_senior(host: Option<u64>, other: Option<u64>) -> bool {
    match (host, other) {
        (Some(host), Some(other)) => host < other,
        (host, other) => host.is_some() && other.is_none(),
    }
}

/// Session of a host whose hello was accepted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Session {
    name: Slug,
    /// Position of the host in the order in which hosts were first stored ([`StreamRecord::seniority`]).
    seniority: Option<u64>,
    pub(super) process: u64,
    pub(super) stream: StreamId,
    pub(super) last_message_at: MonoTime,
    /// Weight of a batch of the length that the hello states; at most the weight of the longest message.
    pub(super) batch_weight: u64,
    /// Number of another process that claims to be this host, and the time of that process's first hello.
    rival_process: Option<(u64, MonoTime)>,
}

impl Session {
    pub(super) fn new(hello: &Hello, seniority: Option<u64>, now: MonoTime) -> Self {
        Self {
            name: hello.host.name.clone(),
            seniority,
            process: hello.process,
            stream: hello.stream,
            last_message_at: now,
            batch_weight: batch_weight(MAX_MESSAGE_BYTES.min(hello.batch_bytes as usize)),
            rival_process: None,
        }
    }
}

/// Decision about a hello.
pub(super) enum Admission {
    /// The host gets a session.
    Granted,
    /// The host gets no session, for this reason.
    Refused(String),
    /// No decision yet: the agent's next hello is decided.
    Later,
}

impl Receiving {
    pub(super) fn admission(&mut self, hello: &Hello, record: StreamRecord, now: MonoTime) -> Admission {
        match self.refusal_reason(hello, record, now) {
            Some(reason) => Admission::Refused(reason),
            None => self.admit_process(hello, now),
        }
    }

    /// Returns the reason to refuse a hello, if any. This function ignores other processes with the same host id:
    /// [`Self::admit_process`] decides between processes.
    fn refusal_reason(&self, hello: &Hello, record: StreamRecord, now: MonoTime) -> Option<String> {
        if let Some(reason) = version_mismatch(hello) {
            return Some(reason);
        }
        let (first, oldest) = (hello.first, hello.oldest);
        if first == 0 || oldest < first || oldest > MAX_BATCH_NUMBER {
            return Some(format!(
                "the spool of this agent is damaged: its stream starts with batch {first}, but its oldest batch is {oldest}; \
                 stop the agent, move the spool's files to another folder, keep them, and start the agent again"
            ));
        }
        let namesake =
            // The name belongs to the host that has been in the database longer: a new host with the same name must not
            // lock out that host.
            self.find_namesake(hello, now).filter(|(_, session)| !is_senior(record.seniority, session.seniority));
        if let Some((other, _)) = namesake {
            let name = &hello.host.name;
            return Some(format!(
                "the name {name} is taken by the host with the id {other}: give one of the two hosts another name"
            ));
        }
        // A stream whose batches wait to be stored has an owner, too, although its mark is not in the database yet.
        let accepted_owner = self.streams.get(&hello.stream).map(|progress| progress.host);
        let owner =
            accepted_owner.or(record.mark.map(|mark| mark.host)).filter(|owner| *owner != hello.host.id)?;
        Some(format!(
            "the spool of this agent belongs to the host with the id {owner}: if this agent's state directory is a copy, \
             give this agent another [agent] state_dir; keep the spool for that host, it may hold events that are not \
             stored"
        ))
    }

    /// Returns another host with the same name that was active recently.
    fn find_namesake(&self, hello: &Hello, now: MonoTime) -> Option<(HostId, &Session)> {
        let host = &hello.host;
        let uses_name = |session: &Session| {
            session.name == host.name && now - session.last_message_at <= self.config.name_timeout
        };
        let namesake = self.hosts.iter().find(|(other, session)| **other != host.id && uses_name(session));
        namesake.map(|(other, session)| (*other, session))
    }

    /// Ends the session of another host that uses the name of the hello's host. Returns the other host.
    pub(super) fn take_back_name(&mut self, hello: &Hello, now: MonoTime) -> Option<HostId> {
        let (other, _) = self.find_namesake(hello, now)?;
        self.handle_goodbye(other);
        Some(other)
    }

    /// Decides between two processes with the same host id. The new process takes over if the old process is silent. If
    /// both processes are active, one of them uses a copied state directory, and the new process is refused.
    fn admit_process(&mut self, hello: &Hello, now: MonoTime) -> Admission {
        let host: HostId = hello.host.id;
        let process_timeout = self.config.process_timeout;
        let old_session = self.hosts.get_mut(&host).filter(|session| session.process != hello.process);
        let Some(session) = old_session.filter(|session| now - session.last_message_at <= process_timeout)
        else {
            return Admission::Granted;
        };
        match session.rival_process {
            // The old process sent a message after the first hello of the new process: both are alive.
            Some((process, first_hello_at))
                if process == hello.process && session.last_message_at > first_hello_at =>
            {
                session.rival_process = None;
                return Admission::Refused(format!(
                    "another agent with the host id {host} is running: one of the two agents uses a copy of the other's \
                     state directory; stop that agent and give it another [agent] state_dir, so that it gets a host id \
                     of its own. Nothing has to be deleted"
                ));
            }
            Some((process, _)) if process == hello.process => {}
            _ => session.rival_process = Some((hello.process, now)),
        }
        Admission::Later
    }
}
