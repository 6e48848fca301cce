//! Errors of Python objects.

use super::frame::FrameError;
use std::path::PathBuf;

use peernet_clock::Span;

use crate::process::{ProcessEnd, ProcessError};

/// Reason that an object cannot be created or that a call failed.
#[derive(Debug, thiserror::Error)]
pub enum PythonError {
    /// The configured name is not the name of an object.
    #[error(
        "{0:?} does not name a Python object: write module::object, such as camera::Camera for the class Camera in \
         camera.py"
    )]
    Name(String),
    /// A value is above its upper limit.
    #[error("{key} = {value} is above the limit of {most}")]
    AboveLimit {
        /// Configuration key.
        key: &'static str,
        /// Configured value.
        value: u64,
        /// Upper limit.
        most: u64,
    },
    /// The system cannot pass an environment variable with this name or value.
    #[error("the environment variable {0:?} has an invalid name or value")]
    Variable(String),
    /// The folder does not exist.
    #[error("{} is not a folder; set folder to the folder that contains the module", .0.display())]
    Folder(PathBuf),
    /// The interpreter does not exist.
    #[error(
        "there is no Python at {0}; install python3, or name an interpreter with the key python or the variable PEERNET_PYTHON"
    )]
    NoPython(String),
    /// Python does not find the module.
    #[error(
        "there is no Python module {module}: it is neither in the folder {} nor among the packages of {python}; write \
         {module}.py in this folder, install the module, or start in the module's folder (in a configuration: folder = \
         \"…\")", .folder.display()
    )]
    NoModule {
        /// Name of the module.
        module: String,
        /// Folder that is searched first.
        folder: PathBuf,
        /// Path of the interpreter.
        python: String,
    },
    /// The object cannot be created.
    #[error("cannot start {object} with {python}: {reason}")]
    Start {
        /// Name of the object.
        object: String,
        /// Path of the interpreter.
        python: String,
        /// Message of Python, or what happened to the process.
        reason: String,
    },
    /// Custom code raised an exception: its text on the first line, then the traceback.
    #[error("{0}")]
    Raised(String),
    /// The value cannot be transferred to the other process with this configuration.
    #[error("{0}")]
    Value(String),
    /// The process ended.
    #[error("the Python process of {object} ended: {end}; it is restarted")]
    Died {
        /// Name of the object.
        object: String,
        /// End of the process.
        end: ProcessEnd,
    },
    /// The call exceeded its timeout, and the process was killed.
    #[error(
        "{object} did not answer within {} s and was killed{stderr_suffix}; it is restarted; if it needs longer, raise \
         timeout_ms (or the option --timeout of peernet --server)", .timeout.seconds()
    )]
    TooSlow {
        /// Name of the object.
        object: String,
        /// The timeout.
        timeout: Span,
        /// The last lines of its standard error as a suffix for a message; may be empty.
        stderr_suffix: String,
    },
    /// The process died repeatedly and is not restarted yet.
    #[error("{object} is restarted in {:.1} s, because it failed repeatedly: {last_failure}", .remaining_delay.seconds())]
    RestartDelayed {
        /// Name of the object.
        object: String,
        /// Time until the next start.
        remaining_delay: Span,
        /// Text of the last failure.
        last_failure: String,
    },
    /// The worker sent an invalid message.
    #[error(
        "the Python process of {object} sent an invalid message: {source}; it was killed and is restarted"
    )]
    InvalidMessage {
        /// Name of the object.
        object: String,
        /// Defect of the message.
        source: FrameError,
    },
    /// No memory can be shared with the process.
    #[error("cannot share memory with the Python process of {object}: {error}")]
    Memory {
        /// Name of the object.
        object: String,
        /// Error of the operating system.
        error: std::io::Error,
    },
    /// The pipe failed.
    #[error(transparent)]
    Process(ProcessError),
}
