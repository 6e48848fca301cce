//! Search and loading of ONNX Runtime's library.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use ort::LoadDynamicError;
use ort::environment::Environment;
use ort::logging::LogLevel;
use peernet_clock::SharedClock;

use super::OnnxRuntimeConfig;
use super::library_log::LibraryLog;
use super::search::{Candidate, SearchSettings};
use crate::LibraryError;

/// The loaded library. A process can load one library, which stays loaded until the process ends.
pub(super) struct Runtime {
    environment: Environment,
    library: PathBuf,
}

/// Number of threads that open, have or use a session.
static USES: AtomicUsize = AtomicUsize::new(0);

/// Use of the library by a thread: starts before the thread opens a session, and ends after the session is released.
// A run of a session can be terminated, but the opening of a session cannot. If the process ends while a session is
// opened, the destructors of the library's static objects would run while the call still uses these objects: with a
// graph of 100,000 nodes, 2 of 40 stops ended with a segmentation fault.
#[derive(Debug)]
pub(super) struct LibraryUse(());

impl LibraryUse {
    pub(super) fn begin() -> Self {
        USES.fetch_add(1, Ordering::SeqCst);
        Self(())
    }
}

impl Drop for LibraryUse {
    fn drop(&mut self) {
        USES.fetch_sub(1, Ordering::SeqCst);
    }
}

/// Returns whether any thread uses ONNX Runtime. The process must then end without running the destructors of
/// libraries: with `_exit(2)`.
pub fn is_library_in_use() -> bool {
    USES.load(Ordering::SeqCst) > 0
}

static LOADED: Mutex<Option<Arc<Runtime>>> = Mutex::new(None);

impl Runtime {
    /// Returns the library that the search finds; loads the library on the first call. `clock` is for the limit on the
    /// library's log messages.
    pub(super) fn get(config: &OnnxRuntimeConfig, clock: &SharedClock) -> Result<Arc<Self>, LibraryError> {
        let search_settings = SearchSettings::from_environment(config.library.as_deref());
        // The lock is held while the library loads, so that two threads do not load it at the same time.
        let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
        let (found, mut searched) = search_settings.search()?;
        if let Some(runtime) = loaded.as_ref() {
            return match found {
                Some(Candidate { path: wanted, .. }) if wanted != runtime.library => {
                    Err(LibraryError::OtherLibraryLoaded { loaded: runtime.library.clone(), wanted })
                }
                _ => Ok(Arc::clone(runtime)),
            };
        }
        let runtime = match found {
            Some(candidate) => Self::load(&candidate, clock)?,
            None => Self::load_from_system(&mut searched, clock)?,
        };
        let runtime = Arc::new(runtime);
        *loaded = Some(Arc::clone(&runtime));
        Ok(runtime)
    }

    pub(super) fn environment(&self) -> &Environment {
        &self.environment
    }

    /// Returns the path of the library, or the name under which the system's loader found the library.
    pub(super) fn library(&self) -> &Path {
        &self.library
    }

    /// Describes the library by its file and its build. Symbolic links are resolved, because only the name of the file
    /// ends with the version.
    pub(super) fn describe(&self) -> String {
        let file = self.library.canonicalize().unwrap_or_else(|_| self.library.clone());
        let build = ort::info().trim_start_matches("ORT Build Info: ");
        // The text from `, cmake` on has the compiler's options. They are long and say nothing more about the library.
        let build = build.split_once(", cmake").map_or(build, |(build, _)| build);
        format!("{}, {build}", file.display())
    }

    /// Lets the system's loader find the library, by its names with and without the version of the interface.
    fn load_from_system(searched: &mut Vec<String>, clock: &SharedClock) -> Result<Self, LibraryError> {
        for name in ["libonnxruntime.so.1", "libonnxruntime.so"] {
            match ort::init_from(name) {
                Ok(builder) => {
                    return Self::from_builder(builder, name.into(), "the system's library path", clock);
                }
                Err(LoadDynamicError::Dlopen { .. }) => {
                    searched.push(format!("{name} in the system's library path: none"));
                }
                Err(error) => {
                    let origin = "the system's library path";
                    return Err(LibraryError::Unusable {
                        library: name.into(),
                        origin,
                        reason: reason(&error),
                    });
                }
            }
        }
        Err(LibraryError::NotFound { searched: std::mem::take(searched) })
    }

    fn load(candidate: &Candidate, clock: &SharedClock) -> Result<Self, LibraryError> {
        let Candidate { path, origin } = candidate;
        let builder = ort::init_from(path).map_err(|error| LibraryError::Unusable {
            library: path.clone(),
            origin,
            reason: reason(&error),
        })?;
        Self::from_builder(builder, path.clone(), origin, clock)
    }

    fn from_builder(
        builder: ort::environment::EnvironmentBuilder,
        library: PathBuf,
        origin: &'static str,
        clock: &SharedClock,
    ) -> Result<Self, LibraryError> {
        // Creating the environment sends a telemetry event before `with_telemetry(false)` has an effect. Therefore
        // `peernetd` and `peernet` also set `ORT_DISABLE_TELEMETRY`.
        let log = LibraryLog::new(clock);
        let log = move |level, _: &str, _: &str, place: &str, message: &str| log.log(level, place, message);
        let environment =
            builder.with_name("peernet").with_telemetry(false).with_logger(Arc::new(log)).build().map_err(
                |error| LibraryError::Unusable {
                    library: library.clone(),
                    origin,
                    reason: error.to_string(),
                },
            )?;
        environment.set_log_level(LogLevel::Warning);
        tracing::debug!(library = %library.display(), origin, "ONNX Runtime loaded");
        Ok(Self { environment, library })
    }
}

fn reason(error: &LoadDynamicError) -> String {
    match error {
        // `error` itself has no reason; its source is the message of the system's loader.
        LoadDynamicError::Dlopen { error, .. } => {
            error.source().map_or(error.to_string(), ToString::to_string)
        }
        LoadDynamicError::MissingApi { .. } => "it is not ONNX Runtime".to_owned(),
        LoadDynamicError::InvalidVersionString => "it does not report its version".to_owned(),
        LoadDynamicError::BadVersion { version_str, .. } => {
            format!("it is version {version_str}, at least 1.{} is needed", ort::MINOR_VERSION)
        }
    }
}
