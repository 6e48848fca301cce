//! Errors of loading a model and of computing a sample.

use std::path::PathBuf;

use hyper::Uri;
use peernet_external::exec::ProgramCallError;
use peernet_external::python::PythonError;

/// Maximum number of models' names in a message.
const MAX_LISTED: usize = 30;

/// Reason why a model cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// No model of that name is offered.
    #[error("no model named {name}; {}", offered_text("this host", .known))]
    UnknownModel {
        /// The requested name.
        name: String,
        /// The models that this host offers.
        known: Vec<String>,
    },
    /// No folder has a model of that name.
    #[error(
        "no model named {name} in {}; {}; search another folder, give a path with a slash, or export the model \
         (models/export_torchvision.py)",
        list_folders(.searched), available_text(.known)
    )]
    NotFound {
        /// The requested name.
        name: String,
        /// The folders that were searched.
        searched: Vec<PathBuf>,
        /// The models in these folders.
        known: Vec<String>,
    },
    /// The request names no model although several are offered.
    #[error("the request names no model; {}; name a model", offered_text("this host", .known))]
    Unnamed {
        /// The models that this host offers.
        known: Vec<String>,
    },
    /// The files of a model in use differ from the files that were loaded.
    #[error("the files of model {0} changed while it is in use; try again after its sessions have ended")]
    Changed(String),
    /// The maximum number of loaded models is reached, and all are in use.
    #[error(
        "cannot load model {model}: the limit of {max} loaded models is reached and all are in use ({}); try again later, or \
         raise [bank] most_loaded on the serving host", .in_use.join(", ")
    )]
    BankFull {
        /// The requested model.
        model: String,
        /// Maximum number of loaded models.
        max: usize,
        /// The loaded models, each with its device.
        in_use: Vec<String>,
    },
    /// Two models have the same name.
    #[error("two models are named {0}; give each a different name")]
    Duplicate(String),
    /// A value is above its upper limit.
    #[error("{value} is too large; at most {max}")]
    AboveLimit {
        /// Key in the model's table.
        key: &'static str,
        /// Configured value.
        value: u64,
        /// Upper limit.
        max: u64,
    },
    /// A key of the model's table has an invalid value, or is missing.
    #[error("{key} of model {model}: {reason}")]
    InvalidKey {
        /// The model.
        model: String,
        /// Key in the model's table.
        key: &'static str,
        /// Defect of the value, and what to write.
        reason: String,
    },
    /// The model is not offered on the requested device.
    #[error(
        "model {model} is not offered on {requested}, only on {offered}; request an offered device or none"
    )]
    OtherDevice {
        /// The model.
        model: String,
        /// The requested device.
        requested: String,
        /// The device on which the model is offered, or a list of these devices.
        offered: String,
    },
    /// No device is offered for the models of the folders.
    #[error(
        "model {0} is offered on no device, because devices is empty in [bank] of the serving host; list a device there, such as \
         \"cpu\""
    )]
    NoDevice(String),
    /// No device has this name.
    #[error(
        "{0:?} is not a device; use cpu, cuda:N, tensorrt:N or openvino:DEVICE (N from 0, DEVICE such as CPU or GPU.0)"
    )]
    InvalidDevice(String),
    /// ONNX Runtime cannot be loaded.
    #[error(transparent)]
    Library(#[from] LibraryError),
    /// The library was built without the execution provider that the device needs.
    #[error(
        "model {model} cannot run on {device}: {} has no {provider} (it has {}); the plain wheel of PyPI is CPU only: \
         install a build of ONNX Runtime for this device (docs/two-machines.md, \"GPUs\") and name it with [onnxruntime] library \
         or ORT_DYLIB_PATH",
        .library.display(), .available.join(", ")
    )]
    NoProvider {
        /// The model.
        model: String,
        /// The requested device.
        device: String,
        /// The execution provider that the device needs.
        provider: &'static str,
        /// The library in use.
        library: PathBuf,
        /// The execution providers that the library has and this program knows.
        available: Vec<&'static str>,
    },
    /// A program cannot be started.
    #[error("model {model}, the program {command}: {error}")]
    Program {
        /// The model.
        model: String,
        /// The program without its arguments, which may be secret.
        command: String,
        /// The error.
        error: ProgramCallError,
    },
    /// A Python object cannot be created.
    #[error(transparent)]
    Python(#[from] PythonError),
    /// A file of the model is missing, unreadable or invalid.
    #[error("cannot use {}: {reason}", .file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// Defect of the file.
        reason: String,
    },
    /// ONNX Runtime refused the model.
    #[error("ONNX Runtime cannot run {} on {device}: {reason}", .file.display())]
    Session {
        /// The model's file.
        file: PathBuf,
        /// The device.
        device: String,
        /// Message of ONNX Runtime.
        reason: String,
    },
    /// The server of a model cannot be used.
    #[error("model {model} at {url}: {reason}")]
    Server {
        /// The model.
        model: String,
        /// URL of the server.
        url: String,
        /// `true` if loading may succeed later without a change of the configuration.
        is_transient: bool,
        /// The error.
        reason: String,
    },
    /// A thread cannot be started.
    #[error("cannot start a thread for model {model}: {reason}")]
    Thread {
        /// The model.
        model: String,
        /// Error of the operating system.
        reason: String,
    },
}

impl LoadError {
    /// Returns whether loading the model may succeed later without a change of the configuration, for example because
    /// its server is not running yet.
    pub const fn is_transient(&self) -> bool {
        matches!(self, Self::Server { is_transient: true, .. })
    }

    /// Returns whether something in the configuration does not exist or cannot be read: a model, its file, a program, a
    /// module or a Python interpreter.
    pub const fn is_missing(&self) -> bool {
        matches!(
            self,
            Self::File { .. }
                | Self::NotFound { .. }
                | Self::UnknownModel { .. }
                | Self::Program { error: ProgramCallError::Command(_), .. }
                | Self::Python(
                    PythonError::NoModule { .. } | PythonError::NoPython(_) | PythonError::Folder(_)
                )
        )
    }
}

impl LoadError {
    /// Returns whether `object` in the configuration is not a valid name of a Python object.
    pub const fn is_invalid_object_name(&self) -> bool {
        matches!(self, Self::Python(PythonError::Name(_)))
    }

    /// Returns the text for a peer that requested the model. The text says what can be requested instead. It contains
    /// neither paths of this host nor addresses of servers behind this host. `host` is the name of this host.
    pub fn to_peer(&self, model: &str, host: &str) -> String {
        match self {
            // The peer tries again until loading succeeds, and shows this reason to its user meanwhile. PEERNet's own
            // words in the reason contain neither the server's address nor the name of the environment variable that
            // holds the API key. A text quoted from the server may contain the address; the next arm then hides the
            // whole reason.
            Self::Server { url, is_transient: true, reason, .. } if !contains_host(reason, url) => {
                format!("model {model} cannot be loaded on host {host}: {reason}")
            }
            Self::NotFound { .. }
            | Self::Library(_)
            | Self::Program { .. }
            | Self::Python(_)
            | Self::File { .. }
            | Self::InvalidKey { .. }
            | Self::Session { .. }
            | Self::Server { .. }
            | Self::Thread { .. } => {
                format!(
                    "model {model} cannot be loaded on host {host}; the log and the incidents of {host} have the reason"
                )
            }
            Self::NoProvider { device, provider, .. } => {
                format!(
                    "model {model} cannot run on {device}: the serving host's ONNX Runtime has no {provider}"
                )
            }
            Self::UnknownModel { name, known } => {
                format!("no model named {name}; {}", offered_text(&format!("host {host}"), known))
            }
            Self::Unnamed { known } => {
                let offered = offered_text(&format!("host {host}"), known);
                format!("the request names no model; {offered}; name a model")
            }
            Self::Changed(_)
            | Self::BankFull { .. }
            | Self::Duplicate(_)
            | Self::AboveLimit { .. }
            | Self::OtherDevice { .. }
            | Self::NoDevice(_)
            | Self::InvalidDevice(_) => self.to_string(),
        }
    }
}

/// Returns whether `text` contains the host of `url` as a whole word, in upper or lower case.
fn contains_host(text: &str, url: &str) -> bool {
    let uri = url.parse::<Uri>();
    let host = uri.as_ref().ok().and_then(Uri::host).unwrap_or_default();
    // An IPv6 address has brackets in a URL only.
    let (host, text) = (host.trim_matches(['[', ']']).to_ascii_lowercase(), text.to_ascii_lowercase());
    let continues_name = |character: char| character.is_ascii_alphanumeric() || "-_".contains(character);
    let is_word_at = |(start, _): (usize, char)| {
        text[start..]
            .strip_prefix(&host)
            .is_some_and(|rest| !rest.starts_with(continues_name) && !text[..start].ends_with(continues_name))
    };
    !host.is_empty() && text.char_indices().any(is_word_at)
}

/// Reason why ONNX Runtime cannot be loaded.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LibraryError {
    /// No library was found.
    #[error(
        "ONNX Runtime was not found; looked for {}; fetch it with `make setup` in a checkout or \
         `python3 deploy/onnxruntime/fetch.py`, or name a library of your own with [onnxruntime] library or \
         ORT_DYLIB_PATH",
        .searched.join(", ")
    )]
    NotFound {
        /// Each path that was searched, in order, with the result.
        searched: Vec<String>,
    },
    /// A library was found, but cannot be used.
    #[error(
        "ONNX Runtime at {} ({origin}) cannot be used: {reason}; fetch the tested one with `make setup` in a \
         checkout or `python3 deploy/onnxruntime/fetch.py`",
        .library.display()
    )]
    Unusable {
        /// The file.
        library: PathBuf,
        /// Step of the search that led to this file.
        origin: &'static str,
        /// Defect of the file.
        reason: String,
    },
    /// The process has already loaded another library. A process can load only one library.
    #[error(
        "ONNX Runtime is already loaded from {}; a process cannot load {} in addition",
        .loaded.display(), .wanted.display()
    )]
    OtherLibraryLoaded {
        /// The loaded library.
        loaded: PathBuf,
        /// The requested library.
        wanted: PathBuf,
    },
}

/// Reason why a request has no answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InferenceError {
    /// The model cannot use this input.
    #[error("model {model} cannot use sample {sample:?}: {reason}")]
    Input {
        /// The model.
        model: String,
        /// Origin of the sample; may be empty.
        sample: String,
        /// Defect of the sample.
        reason: String,
    },
    /// The model failed.
    #[error("model {model} failed: {reason}")]
    Failed {
        /// The model.
        model: String,
        /// Message of the model.
        reason: String,
    },
    /// The server of the model failed.
    #[error("model {model} at {url} failed: {reason}")]
    Server {
        /// The model.
        model: String,
        /// URL of the server.
        url: String,
        /// The error, and what to do.
        reason: String,
    },
    /// The worker panicked. The next sample gets a new worker.
    #[error("model {model} panicked: {message}")]
    Panicked {
        /// The model.
        model: String,
        /// Message of the panic.
        message: String,
    },
    /// The queue is full.
    #[error(
        "the queue of model {model} is full ({capacity} waiting); send fewer samples, or raise workers or queue in its [[model]]"
    )]
    QueueFull {
        /// The model.
        model: String,
        /// Capacity of the queue.
        capacity: usize,
    },
    /// The request was cancelled before its answer was complete. The model computes other requests as before.
    #[error("model {model} gave up this request: nobody waits for its answer any more")]
    Cancelled {
        /// The model.
        model: String,
    },
    /// The model is shutting down.
    #[error("model {model} is shutting down")]
    Stopped {
        /// The model.
        model: String,
    },
}

impl InferenceError {
    /// Returns the text for a peer, which does not show the address of a server behind this host.
    pub fn to_peer(&self) -> String {
        match self {
            Self::Server { model, reason, .. } => {
                Self::Failed { model: model.clone(), reason: hide_urls(reason) }.to_string()
            }
            error => error.to_string(),
        }
    }
}

/// Replaces URLs in a text by `http://…` or `https://…`. The error text of a server, or the target of a redirect, may
/// contain the address of a server.
fn hide_urls(text: &str) -> String {
    let hide = |word: &str| {
        let schemes = ["http://", "https://"].into_iter();
        let scheme_end = schemes.filter_map(|scheme| Some(word.find(scheme)? + scheme.len())).next()?;
        (scheme_end < word.len()).then(|| format!("{}…", &word[..scheme_end]))
    };
    text.split(' ').map(|word| hide(word).unwrap_or_else(|| word.to_owned())).collect::<Vec<_>>().join(" ")
}

fn list_folders(folders: &[PathBuf]) -> String {
    folders.iter().map(|folder| folder.display().to_string()).collect::<Vec<_>>().join(", ")
}

/// Lists at most [`MAX_LISTED`] names, because an answer to a peer must not be long.
fn first_names(names: &[String]) -> String {
    match names.get(..MAX_LISTED) {
        Some(first_names) if names.len() > MAX_LISTED => {
            format!("{} and {} more", first_names.join(", "), names.len() - MAX_LISTED)
        }
        _ => names.join(", "),
    }
}

fn available_text(known: &[String]) -> String {
    match known {
        [] => "the folders contain no model".to_owned(),
        known => format!("the folders contain {}", first_names(known)),
    }
}

fn offered_text(host: &str, known: &[String]) -> String {
    match known {
        [] => format!("{host} offers none: add a [[model]] to its configuration"),
        known => format!("{host} offers {}", first_names(known)),
    }
}
