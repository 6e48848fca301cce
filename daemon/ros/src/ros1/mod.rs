//! ROS 1: a node with topics over TCP (TCPROS) and its registration with the master (XML-RPC).
//!
//! [`Node::new`] checks that the master answers; [`Node::publish`] and [`Node::subscribe`] register topics. Every
//! message for a connected subscriber is counted as sent, dropped, lost or waiting ([`SendCounts`]).
//!
//! This client was written because no crate met the needs of measurements (in November 2026): `roslibrust` 0.26 needs
//! OpenSSL by default, never sets TCP_NODELAY, and drops messages without notice when its channel lags; `rosrust` 0.9
//! does not set TCP_NODELAY either. A node needs little: XML-RPC with the master and other nodes, a header of texts on
//! each connection, and frames with a length.
//!
//! The node asks the master every two seconds whether it is still registered, and every second while the master does
//! not answer. After a restart of the master all topics are registered again within five seconds. Connections do not
//! depend on the master.
//!
//! ROS 1 has no authentication: every host that reaches the ports may call. Headers, frames, calls, connections and
//! publishers of a topic are bounded, and memory is reserved as bytes arrive.
//!
//! `xmlrpc` and `tcpros` have the texts and headers of the protocols, `registration` decides which calls of the master
//! are due, and `slave` reads calls from other nodes; these do no I/O. `registrar`, `rpc`, `acceptor`, `publisher_link`
//! and `outgoing` own tasks and sockets.

mod acceptor;
mod address;
mod environment;
mod error;
mod incoming;
mod lifetime;
mod limits;
mod master;
mod memory;
mod names;
mod node;
mod node_topics;
mod outgoing;
mod publisher;
mod publisher_link;
mod registrar;
mod registration;
mod registration_guard;
mod rpc;
mod slave;
mod socket;
mod subscriber;
pub mod tcpros;
#[cfg(test)]
pub(crate) mod tests;
pub mod xmlrpc;

pub use environment::{Environment, EnvironmentError, RpcUri};
pub use error::NodeError;
pub use incoming::{ReceivedMessage, WhenFull};
pub use limits::QueueLimits;
pub use master::{NamedNodes, SystemState, topic_types};
pub use memory::{MemoryLimit, MessageMemory};
pub use names::{NameError, NodeName};
pub use node::Node;
pub use outgoing::SendCounts;
pub use publisher::{Delivery, PublishOutcome, Publisher, PublisherOptions, SubscriberStatus};
pub use rpc::RpcError;
pub use subscriber::{
    PublisherInfo, PublisherState, PublisherStatus, PublisherWatch, ReceiveCounts, Subscriber,
    SubscriberOptions,
};
pub use tcpros::TopicType;
