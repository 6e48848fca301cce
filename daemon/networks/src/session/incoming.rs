//! Events of a listener, and the answers to them.

use std::net::SocketAddr;
use std::sync::Weak;

use peernet_clock::{RawTime, Stamp};
use peernet_logger::{HostId, Recorder};
use peernet_sample::Sample;

use super::cloud::PortState;
use crate::message::{SessionAccepted, SessionHello, SessionId};

/// Something that arrived at a listener.
#[derive(Debug)]
pub enum Incoming {
    /// An edge asks for a session.
    Open(OpenRequest),
    /// An edge wants an answer.
    Request(IncomingRequest),
    /// A session is over. Also comes for a session that was asked for and not answered yet.
    Closed {
        /// Which.
        session: SessionId,
        /// Whether the edge said goodbye; else its connection is gone.
        said_goodbye: bool,
        /// Number of iterations that the edge's run was to have, where the session ended with that run.
        ordered: Option<u64>,
    },
    /// A connection is worse than it could be.
    Remark {
        /// A session of that connection; `None` when it has none now.
        session: Option<SessionId>,
        /// Problem, its object, and what to do.
        text: String,
    },
    /// An edge got no connection, before it could ask for a session.
    Refused {
        /// The host that it says it is.
        host: Option<HostId>,
        /// Refused edge, and the reason.
        text: String,
    },
}

/// An edge's wish for a session. Dropping it unanswered refuses it.
#[derive(Debug)]
pub struct OpenRequest {
    /// Edge that asks, and what it asks for.
    pub hello: SessionHello,
    /// The session's id, if it is accepted.
    pub session: SessionId,
    /// Address that its connection comes from, if that is known.
    pub address: Option<SocketAddr>,
    shared: Option<Weak<PortState>>,
}

impl OpenRequest {
    pub(crate) const fn new(
        hello: SessionHello,
        session: SessionId,
        address: Option<SocketAddr>,
        shared: Weak<PortState>,
    ) -> Self {
        Self { hello, session, address, shared: Some(shared) }
    }

    /// Opens the session; requests of it may arrive from now on. Returns whether the edge is still there.
    pub fn accept(mut self, accepted: SessionAccepted) -> bool {
        let shared = self.shared.take().and_then(|shared| shared.upgrade());
        shared.is_some_and(|shared| shared.accept(self.session, accepted))
    }

    /// Tells the edge why there will be no session.
    pub fn refuse(mut self, reason: impl Into<String>) {
        if let Some(shared) = self.shared.take().and_then(|shared| shared.upgrade()) {
            shared.refuse(self.session, reason.into());
        }
    }
}

impl Drop for OpenRequest {
    fn drop(&mut self) {
        if let Some(shared) = self.shared.take().and_then(|shared| shared.upgrade()) {
            shared.refuse(self.session, "the cloud dropped the request for a session".into());
        }
    }
}

/// A sample that an edge wants an answer to.
#[derive(Debug)]
pub struct IncomingRequest {
    /// The session it belongs to.
    pub session: SessionId,
    /// Sample to compute on.
    pub sample: Sample,
    /// The iteration's tree, continued on this host; `upload` ended at `received`.
    pub log: Recorder,
    /// When the whole message was there.
    pub received: Stamp,
    /// Takes the answer.
    pub reply: Responder,
}

/// Why a model did not answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Failure {
    /// This sample could not be computed on.
    #[error("{0}")]
    Failed(String),
    /// There is no room for another sample at the moment.
    #[error("{0}")]
    Overloaded(String),
}

/// The request that an answer belongs to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RequestKey {
    pub(crate) session: SessionId,
    pub(crate) request: u64,
    pub(crate) arrival: ArrivalStamp,
}

/// Arrival of a request, as its reply states it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ArrivalStamp {
    pub(crate) raw: RawTime,
    /// Epoch of the free-running clock right before.
    pub(crate) epoch: u32,
    /// Epoch of the wall clock right before.
    pub(crate) wall_epoch: u32,
}

/// Takes the answer to one request, on any thread. Dropping it unanswered tells the edge that the request failed.
#[derive(Debug)]
pub struct Responder {
    key: RequestKey,
    shared: Option<Weak<PortState>>,
}

impl Responder {
    pub(crate) const fn new(key: RequestKey, shared: Weak<PortState>) -> Self {
        Self { key, shared: Some(shared) }
    }

    /// Sends the answer with what this host added to the tree. Never waits; an answer that cannot be handed to
    /// the network is dropped and counted.
    pub fn send(mut self, log: Recorder, result: Result<Sample, Failure>) {
        if let Some(shared) = self.shared.take().and_then(|shared| shared.upgrade()) {
            shared.answer(self.key, Some(log), result);
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
