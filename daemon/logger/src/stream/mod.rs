//! The event stream between an agent and the aggregator: its messages.
//!
//! Two lanes over one connection. The live lane is lossy and small: the agent's own one-second summaries,
//! sent every 250 ms, newest first. The durable lane is numbered batches of finished events, acknowledged
//! after they are stored. The state machines of both ends stand beside the messages, without I/O.

mod event;
mod host;
mod live;
mod message;

pub use event::{Event, Gap, Incident, IncidentKind, Iteration, Outcome, RunDescription, RunEnded};
pub use host::{Hardware, HostDescription, HostMetrics};
pub use live::{
    Accounting, LiveUpdate, OutcomeCounts, PipelineLive, PipelineState, Placement, PlacementKind, Second,
};
pub use message::{Batch, Hello, PROTOCOL, StreamId, ToAgent, ToAggregator};
