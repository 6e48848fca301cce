//! Events of a listener, and the objects through which the caller answers the events.

use std::net::SocketAddr;
use std::sync::Weak;

use peernet_clock::{RawTime, Stamp};
use peernet_logger::{HostId, Recorder};
use peernet_sample::Sample;

use super::cloud::ListenerState;
use super::partial_answer_sender::PartialAnswerSender;
use crate::message::{SessionAccepted, SessionHello, SessionId};

/// Event of a listener.
#[derive(Debug)]
pub enum Incoming {
    /// An edge asks for a session.
    Open(OpenRequest),
    /// An edge sends a sample and expects an answer.
    Request(IncomingRequest),
    /// A session is over, or an edge that asked for a session left before the session was accepted or refused.
    Closed {
        /// The session.
        session: SessionId,
        /// `true` if the edge said goodbye, `false` if its connection is gone.
        said_goodbye: bool,
        /// Number of iterations that the edge's run was planned to have, if the session ended with that run.
        planned_iterations: Option<u64>,
    },
    /// A connection works, but worse than possible; for example, because its path carries only short datagrams.
    Remark {
        /// A session of that connection; `None` if the connection has no session now.
        session: Option<SessionId>,
        /// Description of the problem, its place, and what to do.
        text: String,
    },
    /// An edge was refused before it could ask for a session.
    Refused {
        /// Host id that the edge claims.
        host: Option<HostId>,
        /// The refused edge and the reason.
        text: String,
    },
}

/// An edge's request for a session. Dropping the value without an answer refuses the session.
#[derive(Debug)]
pub struct OpenRequest {
    /// The edge's identity and the model that it asks for.
    pub hello: SessionHello,
    /// Id that the session gets if it is accepted.
    pub session: SessionId,
    /// Address of the other end of the connection, if known.
    pub address: Option<SocketAddr>,
    /// State of the listener; `None` once the request is answered, so that `drop` does not refuse it.
    shared: Option<Weak<ListenerState>>,
}

impl OpenRequest {
    pub(crate) const fn new(
        hello: SessionHello,
        session: SessionId,
        address: Option<SocketAddr>,
        shared: Weak<ListenerState>,
    ) -> Self {
        Self { hello, session, address, shared: Some(shared) }
    }

    /// Accepts the session, whose requests may arrive from now on. Returns whether the edge is still connected.
    pub fn accept(mut self, accepted: SessionAccepted) -> bool {
        let shared = self.shared.take().and_then(|shared| shared.upgrade());
        shared.is_some_and(|shared| shared.accept(self.session, accepted))
    }

    /// Refuses the session and sends the reason to the edge.
    pub fn refuse(mut self, reason: impl Into<String>) {
        if let Some(shared) = self.shared.take().and_then(|shared| shared.upgrade()) {
            shared.refuse(self.session, reason.into());
        }
    }
}

impl Drop for OpenRequest {
    fn drop(&mut self) {
        if let Some(shared) = self.shared.take().and_then(|shared| shared.upgrade()) {
            shared
                .refuse(self.session, "the cloud dropped the request for a session without an answer".into());
        }
    }
}

/// A sample that an edge sent, and for which the edge expects an answer.
#[derive(Debug)]
pub struct IncomingRequest {
    /// Session of the request.
    pub session: SessionId,
    /// Sample to compute on.
    pub sample: Sample,
    /// Tree of the iteration, continued on this host; `upload` ended at `received`.
    pub recorder: Recorder,
    /// Time at which the whole message had arrived.
    pub received: Stamp,
    /// Sends parts of the answer before the answer is complete.
    pub partial_answers: PartialAnswerSender,
    /// Sends the answer.
    pub reply: Responder,
}

/// Reason why a model did not answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Failure {
    /// The computation on this sample failed.
    #[error("{0}")]
    Failed(String),
    /// The model accepts no further sample at the moment.
    #[error("{0}")]
    Overloaded(String),
}

/// Identifies the request that an answer belongs to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RequestKey {
    pub(crate) session: SessionId,
    pub(crate) request: u64,
    pub(crate) arrival: ArrivalStamp,
}

/// Stamps of the arrival of a request. The reply to the request repeats them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ArrivalStamp {
    pub(crate) raw: RawTime,
    /// Epoch of the free-running clock, read right before the stamp.
    pub(crate) epoch: u32,
    /// Epoch of the wall clock, read right before the stamp.
    pub(crate) wall_epoch: u32,
}

/// Sends the answer to one request, from any thread. Dropping the responder without an answer sends a failure to the
/// edge.
#[derive(Debug)]
pub struct Responder {
    key: RequestKey,
    /// State of the listener; `None` once the answer is sent, so that `drop` does not send a failure.
    shared: Option<Weak<ListenerState>>,
}

impl Responder {
    pub(crate) const fn new(key: RequestKey, shared: Weak<ListenerState>) -> Self {
        Self { key, shared: Some(shared) }
    }

    /// Sends the answer with the nodes that this host added to the tree. Waits only if partial answers to the
    /// request fill the network's send queue. An answer that cannot be handed to the network is dropped and counted.
    pub fn send(mut self, recorder: Recorder, result: Result<Sample, Failure>) {
        if let Some(shared) = self.shared.take().and_then(|shared| shared.upgrade()) {
            shared.answer(self.key, Some(recorder), result);
        }
    }
}

impl Drop for Responder {
    fn drop(&mut self) {
        if let Some(shared) = self.shared.take().and_then(|shared| shared.upgrade()) {
            let failure = Failure::Failed("the cloud dropped the request unanswered".into());
            shared.answer(self.key, None, Err(failure));
        }
    }
}
