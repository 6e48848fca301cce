//! What travels between an agent and the aggregator.

use serde::{Deserialize, Serialize};

use peernet_logger::{HostId, Slug};

use crate::{Chain, Event, Hello, HostSecret, LiveUpdate, Nonce, ProofCode, StreamId};

/// Batches of one agent that may be under way at once, however small they are.
pub const MOST_UNDER_WAY: usize = 1_024;

/// What a batch counts in a window, bytes: those of its body, and no less than 1 KiB, because a small one takes its
/// place in memory and in queues as well.
pub fn batch_weight(body_bytes: usize) -> u64 {
    body_bytes.max(1_024) as u64
}

/// From agent to aggregator. The host id is in the message, never in the transport's routing id.
///
/// The durable lane's batches are frames of their own kind ([`super::codec::batch_frame`]): they are checked by hash
/// before anything in them is read. One that is long for its way comes in parts ([`super::codec::part_frame`]), so that a
/// live update can go between them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToAggregator {
    /// Opens the connection; repeated after each reconnect. Answered by [`ToAgent::Challenge`].
    Hello(Hello),
    /// Answers [`ToAgent::Challenge`].
    Proof(Proof),
    /// Live lane.
    Live(LiveUpdate),
    /// Asks for a [`ToAgent::Echo`]: by when that comes the agent knows how long the way is, and how much it carries.
    Echo {
        /// Whose.
        host: HostId,
        /// Bytes that the agent sent on this connection up to here.
        bytes: u64,
    },
    /// The agent is about to stop; nothing more will come.
    Goodbye(HostId),
}

/// That the host of a hello has the secret that belongs to its id.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Proof {
    /// Whose.
    pub host: HostId,
    /// Of the challenge that this answers.
    pub nonce: Nonce,
    /// Made with the secret from the challenge's nonce, the hello and the aggregator's name ([`HostSecret::prove`]).
    pub code: ProofCode,
    /// The secret, where the aggregator asked to be told it.
    pub secret: Option<HostSecret>,
}

/// From aggregator to agent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToAgent {
    /// A hello came; the agent is to prove that it has the secret of the host.
    Challenge {
        /// Name of the aggregator's host.
        aggregator: Slug,
        /// The stream of the hello that this answers.
        stream: StreamId,
        /// What the proof is made of besides the hello.
        nonce: Nonce,
        /// No secret of this host is known here: the proof is to bring it.
        enrol: bool,
        /// Version of the event stream that was chosen for this connection; `None` is the oldest that the agent speaks.
        // An agent of PEERNet 0.1.0 speaks one version and cannot read this field.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        version: Option<u16>,
    },
    /// The hello was accepted.
    Welcome {
        /// Name of the aggregator's host.
        aggregator: Slug,
        /// The stream of the hello that this answers.
        stream: StreamId,
        /// All batches of the stream up to and including this number are stored; `first - 1` when none is.
        stored: u64,
        /// Chain of that batch; `None` when it is not known here (none is stored).
        chain: Option<Chain>,
        /// The process that sent that batch ([`Hello::process`]); `None` when it is not known.
        process: Option<u64>,
        /// What may be under way at once, see [`ToAgent::Ack`].
        window: u32,
    },
    /// The hello was refused; the agent reports the reason and tries again later. Sent without a version that both ends
    /// speak as well, so that its form never changes.
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
        /// What may be under way at once from now on, in units of a batch of [`Hello::batch_bytes`], at least 1:
        /// batches whose weights ([`batch_weight`]) are no more together, at most [`MOST_UNDER_WAY`], and always one.
        window: u32,
    },
    /// Batches are missing here: send them again from this number on.
    Resend {
        /// The stream.
        stream: StreamId,
        /// The first missing number.
        from: u64,
    },
    /// All that was sent before the message with this number has come, whatever becomes of it. Sent at once.
    Echo {
        /// As it was asked.
        bytes: u64,
    },
    /// A message came from a host that has not said hello (the aggregator was restarted), or a batch does not follow
    /// the one before it: say hello again.
    Unknown,
}

/// What a batch's frame says of it, readable even when the events are not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BatchHead {
    /// Whose.
    pub host: HostId,
    /// Which stream.
    pub stream: StreamId,
    /// Which process sends it ([`Hello::process`]).
    pub process: u64,
    /// Contiguous from the stream's first.
    pub number: u64,
    /// Chain of the batch before it.
    pub before: Chain,
    /// Its own chain.
    pub chain: Chain,
    /// How many events it holds.
    pub events: u32,
    /// Number of events in all batches of the spool before it.
    pub events_before: u64,
}

impl BatchHead {
    /// Number of events in all batches of the spool up to and including this one.
    pub const fn events_through(&self) -> u64 {
        self.events_before.saturating_add(self.events as u64)
    }
}

/// Numbered events of one stream, checked and read.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// What the frame says of it.
    pub head: BatchHead,
    /// What happened, in order.
    pub events: Vec<Event>,
}
