//! What can go wrong with a Python object.

use super::frame::FrameError;
use std::path::PathBuf;

use peernet_clock::Span;

use crate::process::{Ended, ProcessError};

/// Why an object could not be had, or a call of it failed.
#[derive(Debug, thiserror::Error)]
pub enum PythonError {
    /// Not the name of an object.
    #[error(
        "{0:?} does not name a Python object: write module::object, such as camera::Camera for the class Camera in \
         camera.py"
    )]
    Name(String),
    /// A value is beyond its upper limit.
    #[error("{key} = {value} is too much; at most {most}")]
    TooMuch {
        /// The key.
        key: &'static str,
        /// What was given.
        value: u64,
        /// The limit.
        most: u64,
    },
    /// Not what a process can be given as a variable of its environment.
    #[error("{0:?} cannot be given to it as an environment variable")]
    Variable(String),
    /// The folder is not there.
    #[error("{} is not a folder; name the one that holds the module", .0.display())]
    Folder(PathBuf),
    /// There is no Python.
    #[error("there is no Python at {0}; install python3, or name one with python or PEERNET_PYTHON")]
    NoPython(String),
    /// The module is in none of the places where Python looks.
    #[error(
        "there is no Python module {module}: looked in {} and where {python} has its packages; write {module}.py there, \
         install it, or start in its folder (a configuration names one with folder = \"…\")", .folder.display()
    )]
    NoModule {
        /// The module.
        module: String,
        /// The folder that is looked in first.
        folder: PathBuf,
        /// The Python.
        python: String,
    },
    /// The object could not be made.
    #[error("cannot start {object} with {python}: {reason}")]
    Start {
        /// The object.
        object: String,
        /// The Python.
        python: String,
        /// What Python said.
        reason: String,
    },
    /// It raised an exception: the first line says which, the rest is the traceback.
    #[error("{0}")]
    Raised(String),
    /// A value that cannot cross the border of the process, or not in this configuration.
    #[error("{0}")]
    Value(String),
    /// The process is gone.
    #[error("the Python process of {object} is gone: {ended}; it is started anew")]
    Died {
        /// The object.
        object: String,
        /// How it ended.
        ended: Ended,
    },
    /// A call took too long, and the process was killed.
    #[error(
        "{object} did not answer within {} s and was killed{last_words}; it is started anew; raise timeout_ms when it \
         needs longer", .after.seconds()
    )]
    TooSlow {
        /// The object.
        object: String,
        /// How long it had.
        after: Span,
        /// The last lines that it printed, in words; may be empty.
        last_words: String,
    },
    /// It died and will be started anew a little later.
    #[error("{object} is started anew in {:.1} s, because it keeps dying: {last}", .left.seconds())]
    Resting {
        /// The object.
        object: String,
        /// How long it still rests.
        left: Span,
        /// Why it died last.
        last: String,
    },
    /// It did not speak as agreed.
    #[error(
        "the Python process of {object} does not speak as agreed: {source}; it was killed and is started anew"
    )]
    Garbled {
        /// The object.
        object: String,
        /// What was wrong.
        source: FrameError,
    },
    /// There is no memory to be shared with it.
    #[error("cannot share memory with the Python process of {object}: {error}")]
    Memory {
        /// The object.
        object: String,
        /// What the system said.
        error: std::io::Error,
    },
    /// Its pipe failed.
    #[error(transparent)]
    Process(ProcessError),
}
