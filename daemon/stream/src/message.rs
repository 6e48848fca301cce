//! Messages between an agent and the aggregator.

use serde::{Deserialize, Serialize};

use peernet_logger::{HostId, Slug};

use crate::{ChainHash, Event, Hello, HostSecret, LiveUpdate, Nonce, ProofCode, StreamId};

/// Maximum number of batches of one agent in flight, regardless of their size.
pub const MAX_IN_FLIGHT_BATCHES: usize = 1_024;

/// Returns the weight of a batch in a window: the bytes of its body, and at least 1 KiB, because a small batch also
/// takes space in memory and in queues.
pub fn batch_weight(body_bytes: usize) -> u64 {
    body_bytes.max(1_024) as u64
}

/// Messages from the agent to the aggregator. The host id in the message identifies the agent; the routing id of the
/// transport does not.
///
/// Batches of the durable lane are frames of another kind ([`super::codec::encode_batch`]): their hash is checked
/// before they are decoded. A batch that is long for its link is sent in parts ([`super::codec::encode_part`]), so that
/// live updates can be sent between them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToAggregator {
    /// Opens the connection; repeated after each reconnect. The answer is [`ToAgent::Challenge`].
    Hello(Hello),
    /// Answers [`ToAgent::Challenge`].
    Proof(Proof),
    /// Update of the live lane.
    Live(LiveUpdate),
    /// Requests [`ToAgent::Echo`], by which the agent measures the round trip and the rate of delivery.
    Echo {
        /// Host that sends the request.
        host: HostId,
        /// Number of bytes that the agent sent on this connection up to the end of the request.
        bytes: u64,
    },
    /// The agent is about to stop, and sends nothing more.
    Goodbye(HostId),
}

/// Proof that the host of a hello has the secret that belongs to its id.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Proof {
    /// Host that sends the proof.
    pub host: HostId,
    /// Nonce of the challenge that the proof answers.
    pub nonce: Nonce,
    /// Code computed with the secret from the challenge's nonce, the hello and the aggregator's name
    /// ([`HostSecret::prove`]).
    pub code: ProofCode,
    /// Secret of the host, if the aggregator asked for it.
    pub secret: Option<HostSecret>,
}

/// Messages from the aggregator to the agent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToAgent {
    /// A hello arrived; the agent must prove that it has the secret of the host.
    Challenge {
        /// Name of the aggregator's host.
        aggregator: Slug,
        /// Stream of the hello that this message answers.
        stream: StreamId,
        /// Random number that the proof must cover.
        nonce: Nonce,
        /// `true` if the aggregator knows no secret of this host, so that the proof must contain it.
        enrol: bool,
        /// Version of the event stream that was chosen for this connection; `None` if the chosen version is the oldest
        /// version that the agent supports.
        // An agent of PEERNet 0.1.0 supports one version and cannot read this field.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        version: Option<u16>,
    },
    /// The hello was accepted.
    Welcome {
        /// Name of the aggregator's host.
        aggregator: Slug,
        /// Stream of the hello that this message answers.
        stream: StreamId,
        /// All batches of the stream up to this number are stored; [`Hello::first`] minus 1 if no batch is stored.
        stored: u64,
        /// Chain hash up to and including the last stored batch; `None` if no batch is stored.
        chain: Option<ChainHash>,
        /// Process that sent the last stored batch ([`Hello::process`]); `None` if it is unknown.
        process: Option<u64>,
        /// Window of batches in flight, see [`ToAgent::Ack`].
        window: u32,
    },
    /// The hello was refused; the agent reports the reason and tries again later. The message is sent even if the ends
    /// have no version in common. Its form therefore never changes.
    Refused {
        /// Error and advice for the user.
        reason: String,
    },
    /// All batches of the stream up to this number are stored.
    Ack {
        /// Stream of the batches.
        stream: StreamId,
        /// Number of the last stored batch.
        through: u64,
        /// New window of batches in flight, at least 1. The sum of their weights ([`batch_weight`]) may be at most
        /// `window` times [`Hello::batch_bytes`], and their number at most [`MAX_IN_FLIGHT_BATCHES`]. One batch in
        /// flight is always allowed.
        window: u32,
    },
    /// Batches are missing; the agent must send them again from this number on.
    Resend {
        /// Stream of the batches.
        stream: StreamId,
        /// Number of the first missing batch.
        from: u64,
    },
    /// All bytes before the request for this echo have arrived; they need not be stored yet. The echo is sent at once
    /// and is separate from acknowledgements, so that a slow store is not mistaken for a slow link.
    Echo {
        /// Value of `bytes` in the request.
        bytes: u64,
    },
    /// The agent must send a hello: a message came from a host without a session (for example because the aggregator
    /// was restarted), or the chain hash of a batch does not continue the chain hash of the previous batch.
    Unknown,
}

/// Head of a batch's frame, which is readable even if the events are not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BatchHead {
    /// Host that sends the batch.
    pub host: HostId,
    /// Stream of the batch.
    pub stream: StreamId,
    /// Process that sends the batch ([`Hello::process`]).
    pub process: u64,
    /// Number of the batch, contiguous from the stream's first.
    pub number: u64,
    /// Chain hash up to and including the previous batch.
    pub previous_chain: ChainHash,
    /// Chain hash up to and including this batch.
    pub chain: ChainHash,
    /// Number of events in the batch.
    pub events: u32,
    /// Number of events in all batches of the spool before this batch.
    pub events_before: u64,
}

impl BatchHead {
    /// Returns the number of events in all batches of the spool up to and including this batch.
    pub const fn events_through(&self) -> u64 {
        self.events_before.saturating_add(self.events as u64)
    }
}

/// A decoded batch whose hash was checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// Head of the frame.
    pub head: BatchHead,
    /// Events in order.
    pub events: Vec<Event>,
}
