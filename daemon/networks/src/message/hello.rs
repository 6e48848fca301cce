//! What two peers tell each other when a session opens.

use std::fmt;

use peernet_clock::ClockIdentity;
use peernet_logger::{HostId, Slug};
use serde::{Deserialize, Serialize};
use uuid::Uuid;

/// The version of the protocol between edge and cloud. Peers of different versions refuse each other.
pub const PROTOCOL: u16 = 1;

/// A session, by the random id that the cloud gave it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct SessionId(Uuid);

impl SessionId {
    /// A new random id.
    pub(crate) fn random() -> Self {
        Self(Uuid::new_v4())
    }
}

impl fmt::Display for SessionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(&self.0, f)
    }
}

/// Who opens a session, and for what.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SessionHello {
    /// The protocol version the edge speaks, [`PROTOCOL`].
    pub protocol: u16,
    /// The edge's id.
    pub host: HostId,
    /// The edge's name.
    pub name: Slug,
    /// The clock that the edge's stamps come from.
    pub clock: ClockIdentity,
    /// The pipeline that samples will come from.
    pub pipeline: Slug,
    /// The model wanted.
    pub model: Slug,
    /// The device it must run on, such as `cuda:0`; `None` leaves it to the cloud.
    pub device: Option<String>,
}

/// Who serves a session, and with what.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SessionAccepted {
    /// The cloud's id.
    pub host: HostId,
    /// The cloud's name.
    pub name: Slug,
    /// The clock that the cloud's stamps come from.
    pub clock: ClockIdentity,
    /// The version of the program that serves, for people.
    pub version: String,
    /// The model.
    pub model: Slug,
    /// The device it really runs on.
    pub device: String,
    /// What the model is, in words, for the run's page.
    pub facts: Vec<(String, String)>,
}
