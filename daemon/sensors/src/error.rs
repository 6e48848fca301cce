//! Errors of sensors and transforms.

use std::io;
use std::path::PathBuf;

use peernet_external::exec::ProgramCallError;
use peernet_external::python::PythonError;
use peernet_imaging::ImageError;
use peernet_ros::topics::TopicError;

/// Reason why a sensor cannot be opened, or why a sample cannot be captured or transformed.
#[derive(Debug, thiserror::Error)]
pub enum SensorError {
    /// The file or folder cannot be read.
    #[error("cannot read {}: {error}", .path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// Error of the operating system.
        error: io::Error,
    },
    /// The folder contains no picture.
    #[error("{} contains no picture; put .jpg, .jpeg or .png files into it or into folders named after their label", .0.display())]
    Empty(PathBuf),
    /// The file is not a regular file, or its name does not end like the name of a picture.
    #[error("{} is neither a folder nor a .jpg, .jpeg or .png file", .0.display())]
    NotAPicture(PathBuf),
    /// The labels cannot be used.
    #[error("cannot use the labels in {}: {reason}", .file.display())]
    Labels {
        /// The file.
        file: PathBuf,
        /// Defect of the file.
        reason: String,
    },
    /// The program cannot be started or gave no sample.
    #[error("the program {command}: {error}")]
    Program {
        /// The program without its arguments, which may be secret.
        command: String,
        /// The error.
        error: ProgramCallError,
    },
    /// The Python object cannot be created or gave no sample.
    #[error(transparent)]
    Python(#[from] PythonError),
    /// The ROS topic gave no message.
    #[error(transparent)]
    Topic(#[from] TopicError),
    /// The ROS message cannot be converted to a sample.
    #[error("cannot convert a message of topic {topic} ({type_name}): {reason}")]
    Message {
        /// The topic.
        topic: String,
        /// Type of the message.
        type_name: String,
        /// Defect of the message.
        reason: String,
    },
    /// The configuration is not valid.
    #[error("{0}")]
    Config(String),
    /// The transform cannot change the sample.
    #[error("cannot {action} sample {sample:?}: {error}")]
    Picture {
        /// Action that failed: `resize`, `crop`, `encode`, `decode`.
        action: &'static str,
        /// Origin of the sample; may be empty.
        sample: String,
        /// The error.
        error: ImageError,
    },
}

impl SensorError {
    /// Returns whether the error is an invalid name of a Python object, the key `object` of the configuration.
    pub const fn is_invalid_object_name(&self) -> bool {
        matches!(self, Self::Python(PythonError::Name(_)))
    }
}
