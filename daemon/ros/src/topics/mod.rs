//! Topics of either version of ROS, for callers that block, such as sensors and actuators.
//!
//! [`TopicReader`] and [`TopicWriter`] exchange the messages of one topic. All of a process share one node for each
//! master or domain, and a thread on which the nodes' sockets are served.

mod error;
mod message_type;
mod nodes;
mod reader;
mod survey;
mod version;
mod writer;

pub use error::TopicError;
pub use message_type::{InvalidMessageType, MessageType};
pub use nodes::shared_ros2_node;
pub use reader::{ReaderOptions, TopicMessage, TopicReader};
pub use survey::{TopicUse, check_name, check_topic, survey_topic};
pub use version::{RosVersion, VersionError};
pub use writer::{TopicWriter, Written};
