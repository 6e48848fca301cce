//! The event stream between an agent and the aggregator: its messages and the state machines of both ends.
//!
//! Two lanes over one connection. The live lane is lossy and small: the agent's own one-second summaries,
//! sent every 250 ms, newest first. The durable lane is numbered batches of finished events, acknowledged
//! after they are stored. The state machines of both ends, [`Sending`] and [`Receiving`], do no I/O: they are told
//! what happened and say what to do.
//!
//! What the durable lane promises: what is in the agent's spool is stored exactly once and in order, whatever
//! the transport loses, repeats or reorders and whichever end is started anew, as long as the aggregator keeps a
//! batch and its stream's mark in one transaction. Two things are excepted, in which nothing is lost but some may be stored
//! twice, in two streams: when a spool was copied, what both copies hold; when it was set back to an old copy, what it
//! holds again. What did not fit into the spool is counted, and a gap stands in
//! its place.

mod bounded;
mod chain;
mod clock;
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
pub use connection::{
    Connection, ConnectionStatistics, DirectionStatistics, NetworkInterface, TransportRoundTrip,
};
pub use counts::{
    CountedEvents, CountedRun, HandedIn, KILLED, MOST_COUNTED_RUNS, RunCounts, SentUnspooled, Settled,
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
    Arrival, Challenges, Greeting, Known, Lacking, Mark, Missing, Proven, Receiving, ReceivingConfig,
};
pub use secret::{HostSecret, InvalidSecret, Nonce, ProofCode};
pub use sending::{Action, Compression, Notice, Sending, SendingConfig};
pub use spool::{SpoolState, SpooledBatch, Usage};
pub use totals::{Reached, Totals};
pub use unresolved::{MOST_SENT_UNSPOOLED, Unresolved};
pub use versions::{Release, VersionMismatch, VersionRange};

#[cfg(test)]
mod tests;
