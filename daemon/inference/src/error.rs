//! Why a model could not be loaded or a sample not be computed on.

use std::path::PathBuf;

use peernet_external::exec::ExchangeError;
use peernet_external::python::PythonError;

/// Most names that are listed.
const LISTED: usize = 30;

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
    /// No folder has a model of that name.
    #[error(
        "no model named {name} in {}; {}; name another folder, give a path with a slash, or export the model \
         (models/export_torchvision.py)",
        listed(.looked), there_is(.known)
    )]
    NotFound {
        /// What was asked for.
        name: String,
        /// The folders that were searched.
        looked: Vec<PathBuf>,
        /// The models in them.
        known: Vec<String>,
    },
    /// Nobody said which of several models is wanted.
    #[error("no model was named; {}; name one", offered(.known))]
    Unnamed {
        /// What this host offers.
        known: Vec<String>,
    },
    /// The files of a model in use are not those that were loaded.
    #[error("model {0} was changed on disk while others use it; ask again when their sessions are over")]
    Changed(String),
    /// No more models of the bank's folders may be in memory.
    #[error(
        "no room for model {model}: {most} models of the bank may be loaded and all are in use ({}); ask again later, or \
         raise [bank] most_loaded on the serving host", .in_use.join(", ")
    )]
    BankFull {
        /// The model.
        model: String,
        /// How many may be in memory.
        most: usize,
        /// Those that are.
        in_use: Vec<String>,
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
    /// A program could not be started.
    #[error("model {model}, the program {command}: {error}")]
    Program {
        /// The model.
        model: String,
        /// The program without its arguments, which may be secret.
        command: String,
        /// What went wrong.
        error: ExchangeError,
    },
    /// A Python object could not be had.
    #[error(transparent)]
    Python(#[from] PythonError),
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

impl LoadError {
    /// Whether something that was named is not there: a model, its file, a program, a module, a Python.
    pub const fn is_missing(&self) -> bool {
        matches!(
            self,
            Self::File { .. }
                | Self::NotFound { .. }
                | Self::UnknownModel { .. }
                | Self::Program { error: ExchangeError::Command(_), .. }
                | Self::Python(
                    PythonError::NoModule { .. } | PythonError::NoPython(_) | PythonError::Folder(_)
                )
        )
    }
}

impl LoadError {
    /// Whether what was named cannot be the name of anything.
    pub const fn is_misnamed(&self) -> bool {
        matches!(self, Self::Python(PythonError::Name(_)))
    }

    /// What a peer that asked for the model is told: what it can ask for instead, and nothing of this host's files.
    pub fn to_peer(&self, model: &str) -> String {
        match self {
            Self::NotFound { .. }
            | Self::Library(_)
            | Self::Program { .. }
            | Self::Python(_)
            | Self::File { .. }
            | Self::Session { .. }
            | Self::Thread { .. } => {
                format!(
                    "model {model} cannot be loaded on the serving host; its log and its incidents say why"
                )
            }
            Self::NoProvider { device, provider, .. } => {
                format!(
                    "model {model} cannot run on {device}: the serving host's ONNX Runtime has no {provider}"
                )
            }
            Self::UnknownModel { .. }
            | Self::Unnamed { .. }
            | Self::Changed(_)
            | Self::BankFull { .. }
            | Self::Duplicate(_)
            | Self::TooMuch { .. }
            | Self::OtherDevice { .. }
            | Self::NoSuchDevice(_) => self.to_string(),
        }
    }
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

fn listed(folders: &[PathBuf]) -> String {
    folders.iter().map(|folder| folder.display().to_string()).collect::<Vec<_>>().join(", ")
}

/// The first names of a list that may be long: an answer to a peer is not.
fn first(names: &[String]) -> String {
    match names.get(..LISTED) {
        Some(first) if names.len() > LISTED => {
            format!("{} and {} more", first.join(", "), names.len() - LISTED)
        }
        _ => names.join(", "),
    }
}

fn there_is(known: &[String]) -> String {
    match known {
        [] => "there is none at all".to_owned(),
        known => format!("there is {}", first(known)),
    }
}

fn offered(known: &[String]) -> String {
    match known {
        [] => "this host offers none: add a [[model]] to its configuration".to_owned(),
        known => format!("this host offers {}", first(known)),
    }
}
