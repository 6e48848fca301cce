//! What travels between an agent and the aggregator.

use serde::{Deserialize, Serialize};

use super::{Event, HostDescription, LiveUpdate};
use crate::host::random_id;
use crate::{HostId, Slug};
use std::fmt;
use std::str::FromStr;
use uuid::Uuid;

/// Version of the event stream's messages. Both ends must agree.
pub const PROTOCOL: u16 = 2;

random_id! {
    /// A stream of batches: made with the agent's spool, so that a new or copied spool is recognised.
    StreamId
}

/// From agent to aggregator. The host id is in the message, never in the transport's routing id.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToAggregator {
    /// Opens the connection; repeated after each reconnect.
    Hello(Hello),
    /// Live lane.
    Live(LiveUpdate),
    /// Durable lane.
    Batch(Batch),
    /// The agent is about to stop; nothing more will come.
    Goodbye(HostId),
}

/// Who connects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// [`PROTOCOL`] of the agent.
    pub protocol: u16,
    /// The host and what it is.
    pub host: HostDescription,
    /// The stream its batches belong to.
    pub stream: StreamId,
    /// Number of the oldest batch the agent still holds.
    pub oldest: u64,
    /// A random number made at process start: tells a reconnect from a second process with a copied host id.
    pub process: u64,
}

/// From aggregator to agent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToAgent {
    /// The hello was accepted.
    Welcome {
        /// Name of the aggregator's host.
        aggregator: Slug,
        /// The stream of the hello that this answers.
        stream: StreamId,
        /// All batches of the stream up to and including this number are stored; 0 when none is.
        stored: u64,
    },
    /// The hello was refused; the agent reports the reason and tries again later.
    Refused {
        /// What is wrong and what to do about it.
        reason: String,
    },
    /// All batches of the stream up to and including this number are stored.
    Ack {
        /// The stream.
        stream: StreamId,
        /// The number.
        through: u64,
    },
    /// Batches are missing here: send them again from this number on.
    Resend {
        /// The stream.
        stream: StreamId,
        /// The first missing number.
        from: u64,
    },
    /// A message came from a host that has not said hello (the aggregator was restarted): say it again.
    Unknown,
}

/// Numbered events of one stream.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Batch {
    /// Whose.
    pub host: HostId,
    /// Which stream.
    pub stream: StreamId,
    /// Contiguous from 1.
    pub number: u64,
    /// What happened, in order.
    pub events: Vec<Event>,
}
