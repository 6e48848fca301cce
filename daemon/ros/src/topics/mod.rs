//! Blocking readers and writers of topics of either version of ROS, for callers such as sensors and actuators.
//!
//! [`TopicReader`] and [`TopicWriter`] exchange the messages of one topic. Those of a process share one node for each
//! master or domain, and a thread that serves the sockets of the nodes, so that the threads of samples do no work for
//! ROS.

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
