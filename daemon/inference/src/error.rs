//! Why a model could not be loaded or a sample not be computed on.

use std::path::PathBuf;

/// Why a model is not there.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// No model of that name is configured.
    #[error("no model named {name}; {}", offered(.known))]
    UnknownModel {
        /// What was asked for.
        name: String,
        /// What this host offers.
        known: Vec<String>,
    },
    /// Two models have one name.
    #[error("two models are named {0}; give each its own name")]
    Duplicate(String),
    /// A value is beyond its upper limit.
    #[error("{value} is too much; at most {most}")]
    TooMuch {
        /// The key in the model's table.
        key: &'static str,
        /// What was given.
        value: u64,
        /// The limit.
        most: u64,
    },
    /// The model is configured for another device.
    #[error("model {model} is not offered on {asked}, only on {offered}; ask for that or name no device")]
    OtherDevice {
        /// The model.
        model: String,
        /// The device that was asked for.
        asked: String,
        /// The device it is configured for.
        offered: String,
    },
    /// A device that no model can run on.
    #[error(
        "{0:?} is not a device; use cpu, cuda:N, tensorrt:N or openvino:DEVICE (N from 0, DEVICE such as CPU or GPU.0)"
    )]
    NoSuchDevice(String),
    /// ONNX Runtime could not be loaded.
    #[error(transparent)]
    Library(#[from] LibraryError),
    /// The library was built without what the device needs.
    #[error(
        "model {model} cannot run on {device}: {} has no {provider} (it has {}); the plain wheel of PyPI is CPU only: \
         install a build of ONNX Runtime for this device (README, \"GPUs\") and name it with [onnxruntime] library \
         or ORT_DYLIB_PATH",
        .library.display(), .available.join(", ")
    )]
    NoProvider {
        /// The model.
        model: String,
        /// The device that was asked for.
        device: String,
        /// The execution provider that the device needs.
        provider: &'static str,
        /// The library in use.
        library: PathBuf,
        /// The execution providers it has, of those this program knows.
        available: Vec<&'static str>,
    },
    /// A file of the model is missing, unreadable or wrong.
    #[error("cannot use {}: {reason}", .file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// ONNX Runtime refused the model.
    #[error("ONNX Runtime cannot run {} on {device}: {reason}", .file.display())]
    Session {
        /// The model's file.
        file: PathBuf,
        /// The device.
        device: String,
        /// What ONNX Runtime said.
        reason: String,
    },
    /// The system gave no thread.
    #[error("cannot start a thread for model {model}: {reason}")]
    Thread {
        /// The model.
        model: String,
        /// What the system said.
        reason: String,
    },
}

/// Why ONNX Runtime itself is not there.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LibraryError {
    /// Nowhere to be found.
    #[error(
        "ONNX Runtime was not found; looked for {}; fetch it with `make setup` in a checkout or \
         `python3 deploy/onnxruntime/fetch.py`, or name a library of your own with [onnxruntime] library or \
         ORT_DYLIB_PATH",
        .looked.join(", ")
    )]
    NotFound {
        /// Each place that was searched, in order, and what was found there.
        looked: Vec<String>,
    },
    /// Found, but it cannot be used.
    #[error(
        "ONNX Runtime at {} ({origin}) cannot be used: {reason}; fetch the tested one with `make setup` in a \
         checkout or `python3 deploy/onnxruntime/fetch.py`",
        .library.display()
    )]
    Unusable {
        /// The file.
        library: PathBuf,
        /// Why this file: which step of the search named it.
        origin: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// A process can load one such library only.
    #[error(
        "ONNX Runtime is loaded from {} already; a process can use one library only, not {} as well",
        .loaded.display(), .wanted.display()
    )]
    AnotherLoaded {
        /// In use.
        loaded: PathBuf,
        /// Asked for.
        wanted: PathBuf,
    },
}

/// Why one sample got no answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InferenceError {
    /// The model cannot take this input.
    #[error("model {model} cannot use sample {sample:?}: {reason}")]
    Input {
        /// The model.
        model: String,
        /// Where the sample came from; may be empty.
        sample: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The model failed.
    #[error("model {model} failed: {reason}")]
    Failed {
        /// The model.
        model: String,
        /// What it said.
        reason: String,
    },
    /// The worker panicked; it was rebuilt.
    #[error("model {model} panicked: {message}")]
    Panicked {
        /// The model.
        model: String,
        /// The panic's message.
        message: String,
    },
    /// More samples wait than the queue holds.
    #[error(
        "the queue of model {model} is full ({capacity} waiting); send less, or raise workers or queue in its [[model]]"
    )]
    QueueFull {
        /// The model.
        model: String,
        /// How many may wait.
        capacity: usize,
    },
    /// The model is shutting down.
    #[error("model {model} is shutting down")]
    Stopped {
        /// The model.
        model: String,
    },
}

fn offered(known: &[String]) -> String {
    match known {
        [] => "this host offers none: add a [[model]] to its configuration".to_owned(),
        known => format!("this host offers {}", known.join(", ")),
    }
}
