//! Errors of actuators.

use peernet_external::exec::{CommandError, ExchangeError};
use peernet_ros::topics::{InvalidMessageType, TopicError};

/// Reason that an actuator did not act on an answer or cannot be built.
#[derive(Debug, thiserror::Error)]
pub enum ActuatorError {
    /// The command of a program cannot be run.
    #[error("the program of an exec actuator: {0}")]
    Command(CommandError),
    /// The program did not act.
    #[error("the program {command}: {error}")]
    Program {
        /// The program without its arguments, which may be secret.
        command: String,
        /// The error.
        error: ExchangeError,
    },
    /// ROS has no message type of this name.
    #[error(transparent)]
    MessageType(#[from] InvalidMessageType),
    /// The answer cannot be published on the topic.
    #[error(transparent)]
    Topic(#[from] TopicError),
    /// The answer is not text, and the topic carries only text.
    #[error("an answer of the type {media} is no text for topic {topic}; set type = \"{bytes}\"")]
    NotText {
        /// Media type of the answer.
        media: String,
        /// The topic.
        topic: String,
        /// Message type that carries any answer.
        bytes: &'static str,
    },
}
