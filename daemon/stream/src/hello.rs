//! The hello: the first message of an agent.

use peernet_logger::random_id;
use serde::{Deserialize, Serialize};

use crate::{Chain, HostDescription};

/// Version of the event stream's messages. Both ends must agree.
pub const PROTOCOL: u16 = 5;

random_id! {
    /// A stream of batches: made with the agent's spool, so that a new or copied spool is recognised.
    StreamId
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
    /// The stream that this one goes on from, where the agent had to leave one: nothing is missing between the two.
    pub previous: Option<StreamId>,
    /// Number of the first batch that there ever was in the stream.
    pub first: u64,
    /// Number of the oldest batch the agent still holds; one more than the newest when it holds none.
    pub oldest: u64,
    /// Chain of the batch before `oldest`.
    pub before: Chain,
    /// Number of events in all batches of the spool before `oldest`: by it the aggregator knows how many it lacks.
    pub events_before_oldest: u64,
    /// Number of events in all batches of the spool before `first`, in earlier streams; `None` when it is not known.
    pub events_before_first: Option<u64>,
    /// Longest body of a batch that the agent cuts, as a rule; bytes. Windows are counted in the weight of such a batch.
    pub batch_bytes: u32,
    /// A random number made at process start: tells a reconnect from a second process with a copied host id.
    pub process: u64,
}
