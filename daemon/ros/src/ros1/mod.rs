//! ROS 1: a node with topics over TCP (TCPROS) and its registration with the master (XML-RPC).
//!
//! [`Node::new`] checks that the master answers; [`Node::publish`] and [`Node::subscribe`] register topics. After a
//! restart of the master all topics are registered again within five seconds. Every message for a connected
//! subscriber is counted as sent, dropped, lost or waiting ([`SendCounts`]).
//!
//! `xmlrpc` and `tcpros` have the protocols' texts and headers, `registration` which calls of the master are due, `slave` what
//! others may ask a node: all without I/O. `registrar`, `rpc`, `acceptor`, `publisher_link` and `outgoing` own tasks and
//! sockets.

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
mod tests;
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
pub use publisher::{Delivery, Published, Publisher, PublisherOptions, SubscriberStatus};
pub use rpc::RpcError;
pub use subscriber::{
    PublisherInfo, PublisherState, PublisherStatus, PublisherWatch, ReceiveCounts, Subscriber,
    SubscriberOptions,
};
pub use tcpros::TopicType;
