//! Errors of readers and writers of topics.

use std::time::Duration;

use thiserror::Error;

use super::version::VersionError;
use crate::messages::EncodeError;
use crate::ros1::{EnvironmentError, NameError, NodeError};
use crate::ros2::Ros2Error;

/// Error of a topic that is read, written or checked.
#[derive(Debug, Error)]
pub enum TopicError {
    /// The version of ROS is unknown.
    #[error(transparent)]
    Version(#[from] VersionError),
    /// An environment variable of ROS 1 cannot be used.
    #[error(transparent)]
    Environment(#[from] EnvironmentError),
    /// The name is not allowed in ROS 1.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The ROS 1 node failed.
    #[error(transparent)]
    Ros1(#[from] NodeError),
    /// The ROS 2 node failed.
    #[error(transparent)]
    Ros2(#[from] Ros2Error),
    /// The message type is missing, which ROS 2 needs.
    #[error("the message type of topic {topic} must be given in ROS 2; `ros2 topic type {topic}` prints it")]
    TypeRequired {
        /// The topic.
        topic: String,
    },
    /// No message arrived in time.
    #[error("no message of topic {topic} within {} s: {reason}", .time_limit.as_secs_f64())]
    NoMessage {
        /// The topic.
        topic: String,
        /// Time limit.
        time_limit: Duration,
        /// State of the publishers, and advice.
        reason: String,
    },
    /// The message cannot be encoded.
    #[error("cannot publish to topic {topic}: {source}")]
    Encode {
        /// The topic.
        topic: String,
        /// Reason.
        source: EncodeError,
    },
    /// The thread of the nodes cannot be started.
    #[error("cannot start the thread of the ROS nodes: {0}")]
    Thread(String),
}

impl TopicError {
    /// Returns whether the reader or writer must be opened again.
    pub fn needs_reopening(&self) -> bool {
        matches!(
            self,
            Self::Ros1(NodeError::Closed { .. })
                | Self::Ros2(Ros2Error::ShutDown { .. } | Ros2Error::Receive { .. })
        )
    }
}
