//! Pipelines that compute nothing: an existing ROS system is observed between two of its topics.
//!
//! Each message of the input topic is an iteration, answered by the message of the output topic that belongs to it. Nodes of
//! the system are not touched: the agent subscribes as one more node, and stamps what it receives on its own host.
//!
//! `pairing` and `arrivals` decide without I/O; `source` and `topic` subscribe, in either version of ROS; `record` makes the tree of an iteration;
//! `session` is the loop of a run and `life` what is around it. `stamps` keeps what agents of other hosts may ask for, and `peer` asks one
//! that observes the same messages on its host.

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

pub(super) use life::live;
pub(super) use source::SourceError;
