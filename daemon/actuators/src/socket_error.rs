//! Errors of actuators that exchange lines with a controller.

use std::io;
use std::num::NonZeroU64;

use peernet_external::process::MAX_TIMEOUT_MS;

/// Reason why an answer was not sent to a controller, or why its feedback cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SocketError {
    /// The timeout is longer than allowed.
    #[error("timeout_ms = {timeout_ms} is above the limit of {MAX_TIMEOUT_MS}")]
    Timeout {
        /// The configured timeout, milliseconds.
        timeout_ms: NonZeroU64,
    },
    /// The name of the controller's host cannot be resolved.
    #[error(
        "cannot resolve the host of the controller at {address}: {error}; correct the name in address, or write the IP address"
    )]
    Resolve {
        /// Address of the controller.
        address: String,
        /// Error of the resolver.
        error: io::Error,
    },
    /// No connection to the controller can be opened.
    #[error("cannot connect to the controller at {address}: {error}; is it running?")]
    Connect {
        /// Address of the controller.
        address: String,
        /// Error of the operating system.
        error: io::Error,
    },
    /// Sending or receiving failed.
    #[error(
        "cannot {operation} the controller at {address}: {error}; the connection is opened again for the next answer"
    )]
    Io {
        /// `send an answer to` or `receive feedback from`.
        operation: &'static str,
        /// Address of the controller.
        address: String,
        /// Error of the operating system.
        error: io::Error,
    },
    /// The controller closed the connection instead of sending feedback.
    #[error(
        "the controller at {0} closed the connection without feedback; the connection is opened again for the next answer"
    )]
    Closed(String),
    /// Connecting, sending an answer or waiting for feedback took longer than the timeout.
    #[error(
        "the controller at {address} did not {waited_for} within {timeout_ms} ms (timeout_ms); the connection is opened again for the next answer"
    )]
    TimedOut {
        /// Address of the controller.
        address: String,
        /// `accept the connection`, `accept the answer` or `send feedback`.
        waited_for: &'static str,
        /// The configured timeout, milliseconds.
        timeout_ms: NonZeroU64,
    },
    /// A part of a line arrived in time, but no line feed.
    #[error(
        "the controller at {address} sent {line} and no line feed within {timeout_ms} ms (timeout_ms); a controller ends each line \
         with a line feed (\\n); the connection is opened again for the next answer"
    )]
    Unterminated {
        /// Address of the controller.
        address: String,
        /// Beginning of the line.
        line: String,
        /// The configured timeout, milliseconds.
        timeout_ms: NonZeroU64,
    },
    /// The feedback that arrived in time is on another iteration.
    #[error(
        "the controller at {address} sent feedback on iteration {other} and none on iteration {iteration} within {timeout_ms} ms \
         (timeout_ms); a controller must send back the iteration of the line that it answers; the connection is opened again \
         for the next answer"
    )]
    OtherIteration {
        /// Address of the controller.
        address: String,
        /// Number of the iteration that the last feedback named.
        other: u64,
        /// Number of the iteration whose action was sent.
        iteration: u64,
        /// The configured timeout, milliseconds.
        timeout_ms: NonZeroU64,
    },
    /// The answer has no form in JSON.
    #[error(
        "cannot send an answer of the type {0} as JSON; use a model that answers with text, JSON or an array of numbers"
    )]
    AnswerType(String),
    /// The answer contains a number that JSON does not have.
    #[error(
        "the model's answer contains {0}, which JSON does not have; nothing was sent to the robot's controller"
    )]
    NotFinite(f64),
    /// The answer has the type JSON or text and is not valid, or an array does not match its shape.
    #[error("the model's answer is not valid: {0}; nothing was sent to the robot's controller")]
    InvalidAnswer(String),
    /// The line is longer than allowed.
    #[error(
        "the model's answer needs a line of more than {limit} bytes; nothing was sent to the robot's controller"
    )]
    AnswerLength {
        /// The limit, bytes.
        limit: usize,
    },
    /// The controller sent a line that is longer than allowed.
    #[error(
        "the controller at {address} sent a line of more than {limit} bytes; the connection is opened again for the next answer"
    )]
    FeedbackLength {
        /// Address of the controller.
        address: String,
        /// The limit, bytes.
        limit: usize,
    },
    /// The controller sent bytes while no answer waited for feedback.
    #[error(
        "the controller at {address} sent {line:?} while no answer waited for feedback; it must send one line for each \
         answer; the connection is opened again for the next answer"
    )]
    Unsolicited {
        /// Address of the controller.
        address: String,
        /// The beginning of the line.
        line: String,
    },
    /// The line is not feedback.
    #[error(
        "the controller at {address} sent {line:?} as feedback: {reason}; feedback must be a JSON object with any of \
         episode_ended, success and reward"
    )]
    Feedback {
        /// Address of the controller.
        address: String,
        /// The beginning of the line.
        line: String,
        /// Defect of the line.
        reason: serde_json::Error,
    },
}
