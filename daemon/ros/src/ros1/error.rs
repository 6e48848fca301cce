//! Errors of a node, its publishers and its subscribers.

use std::net::SocketAddr;

use thiserror::Error;

use super::names::NameError;
use super::rpc::RpcError;

/// An error of a [`Node`](super::Node), its publishers and subscribers.
#[derive(Debug, Error)]
pub enum NodeError {
    /// The master does not answer.
    #[error("no ROS master answers at {uri}: {source}; start roscore there, or set ROS_MASTER_URI")]
    NoMaster {
        /// URI of the master.
        uri: String,
        /// Reason.
        source: RpcError,
    },
    /// The master answered with an error.
    #[error("the ROS master at {uri} refuses {method}: {reason}")]
    MasterRefused {
        /// URI of the master.
        uri: String,
        /// Method of the master's API.
        method: &'static str,
        /// Reason given by the master.
        reason: String,
    },
    /// The server at the master's URI does not implement the master's API.
    #[error(
        "the server at {uri} is not a ROS master: it gave an unexpected answer to {method}; check ROS_MASTER_URI"
    )]
    NotAMaster {
        /// The URI.
        uri: String,
        /// Method of the master's API.
        method: &'static str,
    },
    /// The name is not allowed in ROS.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The node already has a publisher of the topic.
    #[error("topic {topic} is already published by this node; use the publisher that exists")]
    AlreadyPublished {
        /// Global name of the topic.
        topic: String,
    },
    /// The node already has a subscriber of the topic.
    #[error("topic {topic} is already subscribed to by this node; use the subscriber that exists")]
    AlreadySubscribed {
        /// Global name of the topic.
        topic: String,
    },
    /// A publisher needs a specific type.
    #[error("topic {topic} cannot be published with the type *; name the type of its messages")]
    PublishedWildcard {
        /// Global name of the topic.
        topic: String,
    },
    /// A port could not be opened.
    #[error("cannot listen on {address} for other ROS nodes: {source}")]
    Listen {
        /// Address with port 0, which means any free port.
        address: SocketAddr,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The node has ended.
    #[error("the ROS node {node} has ended: {reason}")]
    Closed {
        /// Name of the node.
        node: String,
        /// Reason for its end.
        reason: String,
    },
    /// The message is too long for the protocol.
    #[error("a message of {length} bytes for topic {topic} is too long; ROS 1 allows 2^32 − 1 bytes")]
    MessageTooLong {
        /// Global name of the topic.
        topic: String,
        /// Length of the message, bytes.
        length: usize,
    },
}
