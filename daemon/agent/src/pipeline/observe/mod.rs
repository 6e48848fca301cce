//! Pipelines that only observe: the latency of a running ROS system between two of its topics.
//!
//! Each message of the input topic is an iteration. The answer of the iteration is the message of the output topic that
//! is paired with the input message. The nodes of the system are not changed: the agent subscribes as an additional
//! node, and stamps messages when the agent receives them.
//!
//! `pairing` and `arrivals` compute without I/O. `source` and `topic` subscribe, in either version of ROS; in ROS 2 a
//! subscription needs a type, which discovery learns from a publisher. `record` builds the tree of an iteration. The
//! observed latency is recorded as the stage `inference`, so that live statistics, store and pages need no special
//! case. `session` is the loop of a run, and `lifecycle` connects and restarts it.
//!
//! `stamps` keeps the stamps that agents on other hosts may query. `peer` queries such an agent, which observes the
//! same messages on its host. The stamps of both hosts separate the network's time from the nodes' time.

mod arrivals;
mod lifecycle;
mod message;
mod pairing;
mod peer;
mod record;
mod session;
mod source;
mod stamps;
mod topic;

pub(super) use lifecycle::run_to_end;
pub(super) use source::SourceError;
