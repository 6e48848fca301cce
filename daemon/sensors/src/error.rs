//! What can go wrong with a sensor or a transform.

use std::io;
use std::path::PathBuf;

use peernet_external::exec::ExchangeError;
use peernet_external::python::PythonError;
use peernet_imaging::ImageError;
use peernet_ros::topics::TopicError;

/// Why a sensor could not be opened, a sample not be had or not be changed.
#[derive(Debug, thiserror::Error)]
pub enum SensorError {
    /// A file or folder that cannot be read.
    #[error("cannot read {}: {error}", .path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// A folder without pictures.
    #[error("{} holds no picture: put .jpg, .jpeg or .png files into it or into folders named after their label", .0.display())]
    Empty(PathBuf),
    /// A single file that is not a picture by its name.
    #[error("{} is neither a folder nor a .jpg, .jpeg or .png file", .0.display())]
    NotAPicture(PathBuf),
    /// Labels that cannot be used.
    #[error("cannot use the labels in {}: {reason}", .file.display())]
    Labels {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A program that gave no sample.
    #[error("the program {command}: {error}")]
    Program {
        /// The program without its arguments, which may be secret.
        command: String,
        /// What went wrong.
        error: ExchangeError,
    },
    /// A Python object that could not be had, or gave no sample.
    #[error(transparent)]
    Python(#[from] PythonError),
    /// A ROS topic that gave no message.
    #[error(transparent)]
    Topic(#[from] TopicError),
    /// A ROS message that is no sample.
    #[error("a message of topic {topic} ({of}) cannot be used: {reason}")]
    Message {
        /// The topic.
        topic: String,
        /// Type of the message.
        of: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A configuration that contradicts itself.
    #[error("{0}")]
    Config(String),
    /// A sample that a transform cannot change.
    #[error("cannot {action} sample {sample:?}: {error}")]
    Picture {
        /// What was tried: `resize`, `crop`, `encode`, `decode`.
        action: &'static str,
        /// Where the sample came from; may be empty.
        sample: String,
        /// What is wrong with it.
        error: ImageError,
    },
}

impl SensorError {
    /// Whether what was named cannot be the name of anything.
    pub const fn is_misnamed(&self) -> bool {
        matches!(self, Self::Python(PythonError::Name(_)))
    }
}
