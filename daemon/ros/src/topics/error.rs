//! Why messages of a topic cannot be exchanged.

use std::time::Duration;

use thiserror::Error;

use super::version::VersionError;
use crate::messages::EncodeError;
use crate::ros1::{EnvironmentError, NameError, NodeError};
use crate::ros2::Ros2Error;

/// An error of a topic that is read, written or looked at.
#[derive(Debug, Error)]
pub enum TopicError {
    /// The version of ROS is not known.
    #[error(transparent)]
    Version(#[from] VersionError),
    /// An environment variable of ROS 1 cannot be used.
    #[error(transparent)]
    Environment(#[from] EnvironmentError),
    /// A name that ROS 1 does not allow.
    #[error(transparent)]
    Name(#[from] NameError),
    /// An error of the node of ROS 1.
    #[error(transparent)]
    Ros1(#[from] NodeError),
    /// An error of the node of ROS 2.
    #[error(transparent)]
    Ros2(#[from] Ros2Error),
    /// ROS 2 finds nobody without the type.
    #[error("the message type of topic {topic} must be given in ROS 2; `ros2 topic type {topic}` prints it")]
    TypeRequired {
        /// The topic.
        topic: String,
    },
    /// No message came in time.
    #[error("no message of topic {topic} within {} s: {reason}", .waited.as_secs_f64())]
    NoMessage {
        /// The topic.
        topic: String,
        /// How long it was waited.
        waited: Duration,
        /// What is known of the publishers, and what to do.
        reason: String,
    },
    /// A message that the wire form cannot hold.
    #[error("cannot publish to topic {topic}: {source}")]
    Encode {
        /// The topic.
        topic: String,
        /// Reason.
        source: EncodeError,
    },
    /// There is no thread for the nodes.
    #[error("cannot start the thread of the ROS nodes: {0}")]
    Thread(String),
}

impl TopicError {
    /// Whether the reader or writer is of no use any more and must be opened again.
    pub fn is_end(&self) -> bool {
        matches!(
            self,
            Self::Ros1(NodeError::Closed { .. })
                | Self::Ros2(Ros2Error::ShutDown { .. } | Ros2Error::Receive { .. })
        )
    }
}
