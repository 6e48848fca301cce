//! Pipelines that only observe: the latency of a running ROS system between two of its topics.
//!
//! Each message of the input topic is an iteration, answered by the message of the output topic that belongs to it.
//! The nodes of the system are not changed: the agent subscribes as one more node, and stamps messages when it
//! receives them.
//!
//! `pairing` and `arrivals` decide without I/O; `source` and `topic` subscribe, in either version of ROS (in ROS 2 a
//! subscription needs a type, which discovery finds out from the publisher first); `record` makes the tree of an
//! iteration, whose stage is `inference`, so that live statistics, store and pages need no special case. `session` is
//! the loop of a run and `life` connects and restarts it.
//!
//! `stamps` keeps what agents on other hosts may ask for, and `peer` asks such an agent, which observes the same
//! messages on its host. Both together give the share of the network.

mod arrivals;
mod life;
mod message;
mod pairing;
mod peer;
mod record;
mod session;
mod source;
mod stamps;
mod topic;

pub(super) use life::run_to_end;
pub(super) use source::SourceError;
