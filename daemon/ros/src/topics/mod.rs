//! Blocking readers and writers of topics of either version of ROS, for callers such as sensors and actuators.
//!
//! [`TopicReader`] and [`TopicWriter`] receive and send the messages of one topic. All readers and writers of a process
//! share one node for each master or domain. One thread serves the sockets of these nodes, so that the threads of
//! sensors and actuators do no work for ROS.

mod error;
mod message_type;
mod nodes;
mod reader;
mod topic_check;
mod version;
mod writer;

pub use error::TopicError;
pub use message_type::{InvalidMessageType, MessageType};
pub use nodes::shared_ros2_node;
pub use reader::{ReaderOptions, TopicMessage, TopicReader};
pub use topic_check::{TopicAccess, check_name, check_topic, check_topic_at_master};
pub use version::{RosVersion, VersionError};
pub use writer::{TopicWriter, WriteOutcome};
