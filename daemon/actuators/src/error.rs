//! Errors of actuators.

use peernet_external::exec::{CommandError, ProgramCallError};
use peernet_external::python::PythonError;
use peernet_ros::topics::{InvalidMessageType, TopicError};

use crate::socket_error::SocketError;

/// Reason why an actuator did not act on an answer or cannot be built.
#[derive(Debug, thiserror::Error)]
pub enum ActuatorError {
    /// The command of a program cannot be run.
    #[error("cannot run the program of an exec actuator: {0}")]
    Command(CommandError),
    /// The program did not start or did not act.
    #[error("the program {command}: {error}")]
    Program {
        /// The program without its arguments, which may be secret.
        command: String,
        /// The error.
        error: ProgramCallError,
    },
    /// The Python object cannot be created or did not act.
    #[error(transparent)]
    Python(#[from] PythonError),
    /// The feedback cannot be read.
    #[error(
        "cannot read the feedback of {actuator}: {reason}; feedback must be an object with any of episode_ended, success and reward"
    )]
    Feedback {
        /// Name of the actuator.
        actuator: String,
        /// Defect of the feedback.
        reason: serde_json::Error,
    },
    /// The answer was not sent to the controller, or the controller gave no feedback.
    #[error(transparent)]
    Socket(#[from] SocketError),
    /// ROS has no message type of this name.
    #[error(transparent)]
    MessageType(#[from] InvalidMessageType),
    /// The answer cannot be published on the topic.
    #[error(transparent)]
    Topic(#[from] TopicError),
    /// At present, answers cannot be published on the topic.
    #[error("{0}")]
    NotPublished(String),
    /// The answer is not text, and the topic carries only text.
    #[error(
        "cannot publish an answer of the type {media} as text on topic {topic}; set type = \"{bytes_type}\""
    )]
    NotText {
        /// Media type of the answer.
        media: String,
        /// The topic.
        topic: String,
        /// Message type for answers of any type.
        bytes_type: &'static str,
    },
}
