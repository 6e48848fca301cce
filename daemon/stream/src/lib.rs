//! The event stream between an agent and the aggregator: its messages and the state machines of both ends.
//!
//! One connection carries two lanes. The live lane is small and may lose data: it sends the agent's own one-second
//! summaries every 250 ms, newest first. The durable lane sends numbered batches of finished events, which are
//! acknowledged after they are stored. The state machines of the two ends, [`Sending`] and [`Receiving`], do no I/O:
//! their callers report by a method call what happened, and the method returns what to do.
//!
//! Guarantee of the durable lane: every event in the agent's spool is stored exactly once and in order. This holds
//! whatever the transport loses, repeats or reorders, and whichever end restarts. It requires that the aggregator
//! stores a batch and its stream's mark ([`HighWaterMark`]) in one transaction.
//!
//! There are two exceptions. If a spool was copied, events that are in both copies may be stored twice, in two streams.
//! If a spool was restored from an old copy, the events in that copy may be stored twice, too. No event is lost in
//! either case.
//!
//! Events that did not fit into the spool are counted, and a gap is sent in their place.
//!
//! The guarantee is achieved by the following means:
//!
//! - *Missing events* are counted as a difference: the number of events before the oldest batch that the agent still
//!   holds, minus the number of events up to the last stored batch. The hello states the first number. The stream's row
//!   in the database has the second number, which follows from the head of the last stored batch. An aggregator whose
//!   database was deleted or restored thus learns how many events are missing from the database.
//! - *Exactly once* follows from the mark: a batch whose number is not above the mark is acknowledged and not stored
//!   again.
//! - *The identity of a spool* is its chain hash ([`ChainHash`]). Numbers alone cannot distinguish a restored disk, a
//!   copied machine, or a spool that lost its last batches in a power failure, from the original spool. Each welcome
//!   states the chain hash at the mark. Before the agent deletes anything, it compares this chain hash with the chain
//!   hash of its own batch. If the chain hashes differ, the agent continues in a new stream.
//! - *Memory* is bounded everywhere: the agent's queue, the memory before the spool, the spool, the bytes in flight,
//!   and the aggregator's queue. When all these places are full, the newest event is dropped, counted for its run, and
//!   reported in a gap. `produced = stored + waiting + dropped` always holds.
//!
//! The tests in `tests` run both state machines against a transport that loses, repeats, reorders and alters frames,
//! with failing disks, kills at any point, restored databases, and copied and deleted spools.

mod bounded;
mod chain_hash;
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

pub use chain_hash::ChainHash;
pub use clock::{
    ClockSample, DelayPoint, DelaySecond, HostClock, LinkLive, ProbeCounts, Probing, ReflectorLive, RoundTrip,
};
pub use clock_fault_fact::FaultyHost;
pub use connection::{
    Connection, ConnectionStatistics, DirectionStatistics, NetworkInterface, TransportRoundTrip,
};
pub use counts::{
    CountedEvents, CountedRun, KILLED_REASON, MAX_COUNTED_RUNS, RunCounts, SentUnspooled, SettledEvents,
    SubmittedEvents,
};
pub use end_reason::EndReason;
pub use estimate_basis::EstimateBasis;
pub use event::{
    Event, EventOrigin, Gap, Incident, IncidentKind, Iteration, Outcome, RunDescription, RunEnded,
};
pub use experiment::{Condition, ExperimentPosition, Grade};
pub use hello::{AGENT_STREAM_VERSIONS, Hello, HelloExtension, STREAM_VERSIONS, StreamId};
pub use host::{Hardware, HostDescription, HostMetrics, ModelMetrics};
pub use live::{
    Accounting, LiveUpdate, OutcomeCounts, PipelineLive, PipelineState, Placement, PlacementKind, Second,
    bound_names,
};
pub use message::{Batch, BatchHead, MAX_IN_FLIGHT_BATCHES, Proof, ToAgent, ToAggregator, batch_weight};
pub use network_name::NetworkName;
pub use receiving::{
    Arrival, Challenges, HelloResult, HighWaterMark, MissingBatches, MissingPreviousBatches, ProofResult,
    Receiving, ReceivingConfig, StreamRecord,
};
pub use secret::{HostSecret, InvalidSecret, Nonce, ProofCode, bytes_from_hexadecimal};
pub use sending::{Action, Compression, Notice, Sending, SendingConfig};
pub use spool::{SpoolState, SpooledBatch, Usage};
pub use totals::{NewestSendableBatch, Totals};
pub use unresolved::{MAX_SENT_UNSPOOLED, UnresolvedBatches};
pub use versions::{Release, VersionMismatch, VersionRange};

#[cfg(test)]
mod tests;
