//! Errors of actuators.

use peernet_external::exec::{CommandError, ExchangeError};
use peernet_ros::topics::{InvalidMessageType, TopicError};

/// The reason why an answer was not acted upon, or why an actuator cannot be built.
#[derive(Debug, thiserror::Error)]
pub enum ActuatorError {
    /// The command of a program cannot be run.
    #[error("the program of an exec actuator: {0}")]
    Command(CommandError),
    /// A program that did not act.
    #[error("the program {command}: {error}")]
    Program {
        /// The program without its arguments, which may be secret.
        command: String,
        /// What went wrong.
        error: ExchangeError,
    },
    /// A message type that ROS does not have.
    #[error(transparent)]
    MessageType(#[from] InvalidMessageType),
    /// A ROS topic to which nothing can be published.
    #[error(transparent)]
    Topic(#[from] TopicError),
    /// An answer that a topic of texts cannot carry.
    #[error("an answer of the type {media} is no text for topic {topic}; set type = \"{bytes}\"")]
    NotText {
        /// The media type of the answer.
        media: String,
        /// The topic.
        topic: String,
        /// The message type that carries any answer.
        bytes: &'static str,
    },
}
