//! The event stream between an agent and the aggregator: its messages and the state machines of both ends.
//!
//! Two lanes over one connection. The live lane is lossy and small: the agent's own one-second summaries,
//! sent every 250 ms, newest first. The durable lane is numbered batches of finished events, acknowledged
//! after they are stored. The state machines of both ends, [`Sending`] and [`Receiving`], do no I/O: they are told
//! what happened and say what to do.
//!
//! What the durable lane promises: what is in the agent's spool is stored exactly once and in order, whatever
//! the transport loses, repeats or reorders and whichever end is started anew, as long as the aggregator keeps a
//! batch and its stream's mark in one transaction. What did not fit into the spool is counted, and a gap stands in
//! its place.

mod bounded;
mod clock;
pub mod codec;
mod event;
mod host;
mod intake;
mod live;
mod losses;
mod message;
mod receiving;
mod sending;
mod spool;

pub use clock::{ClockSample, DelayPoint, DelaySecond, HostClock, LinkLive, ProbeCounts, Probing, RoundTrip};
pub use event::{Event, Gap, Incident, IncidentKind, Iteration, Outcome, RunDescription, RunEnded};
pub use host::{Hardware, HostDescription, HostMetrics};
pub use live::{
    Accounting, LiveUpdate, OutcomeCounts, PipelineLive, PipelineState, Placement, PlacementKind, Second,
};
pub use message::{Batch, Hello, PROTOCOL, StreamId, ToAgent, ToAggregator};
pub use receiving::{Arrival, Greeting, Missing, Receiving, ReceivingConfig};
pub use sending::{Notice, Sending, SendingConfig};
pub use spool::{MemorySpool, Spool, SpoolError, SpooledBatch, Usage};

#[cfg(test)]
mod tests;
