//! The event stream between an agent and the aggregator: its messages and the state machines of both ends.
//!
//! One connection carries two lanes. The live lane is small and may lose data: it sends the agent's own one-second
//! summaries every 250 ms, newest first. The durable lane sends numbered batches of finished events, which are
//! acknowledged after they are stored. The state machines of the two ends, [`Sending`] and [`Receiving`], do no I/O:
//! their methods report what happened, and return what to do.
//!
//! Guarantee of the durable lane: every event in the agent's spool is stored exactly once and in order, whatever the
//! transport loses, repeats or reorders and whichever end restarts, as long as the aggregator stores a batch and its
//! stream's mark in one transaction. Two cases are excepted, in which no event is lost but some may be stored twice, in
//! two streams: if a spool was copied, the events that both copies hold; if it was set back to an old copy, the events
//! that it holds again. Events that did not fit into the spool are counted, and a gap is sent in their place.
//!
//! The guarantee rests on the following:
//!
//! - *Missing events* are a difference: the head of each batch contains the number of events in all batches before it,
//!   the stream's row in the database stores it, and a hello states it for the oldest batch that the agent still holds.
//!   A database that was deleted or restored thus learns how many events it lacks.
//! - *Exactly once* follows from the mark: a batch at or below the mark is acknowledged and not stored.
//! - *The identity of a spool* is its chain of hashes ([`Chain`]). Numbers alone cannot distinguish a restored disk, a
//!   copied machine or a tail lost in a power failure from the original spool. Both ends compare the chain at the mark
//!   at each welcome, before anything is deleted. If it differs, the agent continues in a new stream.
//! - *Memory* is bounded everywhere: the agent's queue, the memory before the spool, the spool, the bytes in flight,
//!   and the aggregator's queue. The last resort is to drop the newest event, count it for its run, and report it in a
//!   gap. `produced = stored + waiting + dropped` always holds.
//!
//! The tests in `tests` run both state machines against a transport that loses, repeats, reorders and alters frames,
//! with failing disks, kills at any point, restored databases, and copied and deleted spools.

mod bounded;
mod chain;
mod clock;
mod clock_fault_fact;
pub mod codec;
mod connection;
mod counts;
mod end_reason;
mod estimate_basis;
mod event;
mod experiment;
#[doc(hidden)]
pub mod fuzzing;
mod hello;
mod host;
pub mod limits;
mod live;
mod message;
mod network_name;
mod receiving;
mod secret;
mod sending;
mod spool;
mod totals;
mod unresolved;
mod versions;

pub use chain::Chain;
pub use clock::{
    ClockSample, DelayPoint, DelaySecond, HostClock, LinkLive, ProbeCounts, Probing, ReflectorLive, RoundTrip,
};
pub use clock_fault_fact::FaultyHost;
pub use connection::{
    Connection, ConnectionStatistics, DirectionStatistics, NetworkInterface, TransportRoundTrip,
};
pub use counts::{
    CountedEvents, CountedRun, HandedInEvents, KILLED, MOST_COUNTED_RUNS, RunCounts, SentUnspooled,
    SettledEvents,
};
pub use end_reason::EndReason;
pub use estimate_basis::EstimateBasis;
pub use event::{Claim, Event, Gap, Incident, IncidentKind, Iteration, Outcome, RunDescription, RunEnded};
pub use experiment::{Condition, ExperimentPlace, Grade};
pub use hello::{AGENT_STREAM_VERSIONS, Hello, HelloExtension, STREAM_VERSIONS, StreamId};
pub use host::{Hardware, HostDescription, HostMetrics};
pub use live::{
    Accounting, LiveUpdate, OutcomeCounts, PipelineLive, PipelineState, Placement, PlacementKind, Second,
};
pub use message::{Batch, BatchHead, MOST_UNDER_WAY, Proof, ToAgent, ToAggregator, batch_weight};
pub use network_name::NetworkName;
pub use receiving::{
    Arrival, Challenges, Greeting, LackingBatches, Mark, MissingBatches, ProofResult, Receiving,
    ReceivingConfig, StreamRecord,
};
pub use secret::{HostSecret, InvalidSecret, Nonce, ProofCode};
pub use sending::{Action, Compression, Notice, Sending, SendingConfig};
pub use spool::{SpoolState, SpooledBatch, Usage};
pub use totals::{NewestSentBatch, Totals};
pub use unresolved::{MOST_SENT_UNSPOOLED, UnresolvedBatches};
pub use versions::{Release, VersionMismatch, VersionRange};

#[cfg(test)]
mod tests;
