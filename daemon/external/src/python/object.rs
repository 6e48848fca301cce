//! A user's object and the process in which it runs.

use std::path::PathBuf;

use bytes::Bytes;
use peernet_clock::{MonoTime, SharedClock, Span};
use peernet_sample::{Part, printable_lines};
use serde::{Deserialize, Serialize};

use super::frame::{FrameError, Reply, Request};
use super::interpreter;
use super::worker::{Trouble, Worker};
use super::{Called, PythonConfig, PythonError, Stage, Times};
use crate::digest;
use crate::process::{Launch, ProcessError, Restarts};

/// Time that a process has to end after it is no longer needed.
const GRACE: Span = Span::from_millis(1000);

/// Role of an object in a pipeline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// Sensor; the object has `sample()`.
    Sensor,
    /// Model; the object has `infer(x)`, and may have `preprocess(x)` and `postprocess(y)`.
    Model,
}

/// Description of an object, as its process reports it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
pub struct About {
    /// Version of Python, such as `3.11.2`.
    pub python: String,
    /// Path of the interpreter.
    executable: String,
    /// Description of the object, such as `class camera::Camera`.
    pub what: String,
    /// Users' own files that the object is made of, beginning with that of its module.
    files: Vec<PathBuf>,
    /// Names and versions of the libraries that these files import anywhere, and of everything that was imported
    /// during the start; a version may be empty.
    libraries: Vec<(String, String)>,
    /// `true` if `files` or `libraries` is incomplete because of its limit.
    more: bool,
}

impl About {
    /// Returns facts for the run's page, such as (`Sensor`, `the Python class camera::Camera, Python 3.11.2`). The
    /// name of each begins with `role`. Reads the files for their hashes.
    pub fn facts(&self, role: &str) -> Vec<(String, String)> {
        let mut facts = vec![(role.to_owned(), format!("the Python {}, Python {}", self.what, self.python))];
        if !self.executable.is_empty() {
            facts.push((format!("{role} interpreter"), printable_lines(&self.executable).into_owned()));
        }
        facts.extend(digest::fact(role, &self.files));
        if !self.libraries.is_empty() {
            let library = |(name, version): &(String, String)| match version.as_str() {
                "" => printable_lines(name).into_owned(),
                version => printable_lines(&format!("{name} {version}")).into_owned(),
            };
            let libraries: Vec<String> = self.libraries.iter().map(library).collect();
            facts.push((format!("{role} libraries"), libraries.join(", ")));
        }
        if self.more {
            facts.push((format!("{role} imports"), "more than is told here".to_owned()));
        }
        facts
    }
}

/// Python object in a process of its own, which is restarted when it dies. Dropping it ends the process.
#[derive(Debug)]
pub struct PythonObject {
    config: PythonConfig,
    role: Role,
    launch: Launch,
    clock: SharedClock,
    about: About,
    worker: Option<Worker>,
    restarts: Restarts,
    /// Text of the last failure, returned to callers while the process is not restarted.
    last: String,
}

impl PythonObject {
    /// Checks whether an object exists without running any of the user's code: its name, folder and interpreter, and
    /// whether Python finds the module. Blocks for some tens of milliseconds.
    ///
    /// # Errors
    /// The first failed check.
    pub fn check(config: &PythonConfig, clock: &SharedClock) -> Result<(), PythonError> {
        interpreter::check(config, clock)
    }

    /// Starts the process, imports the module and creates the object; blocks until that is done.
    ///
    /// `name` is the owner in log messages; `device` becomes the environment variable `PEERNET_DEVICE`.
    ///
    /// # Errors
    /// If the object cannot be created.
    pub fn start(
        config: &PythonConfig,
        role: Role,
        name: &str,
        device: Option<&str>,
        clock: &SharedClock,
    ) -> Result<Self, PythonError> {
        interpreter::check(config, clock)?;
        let mut object = Self {
            config: config.clone(),
            role,
            launch: interpreter::launch(config, name.to_owned(), device)?,
            clock: SharedClock::clone(clock),
            about: About::default(),
            worker: None,
            restarts: Restarts::default(),
            last: String::new(),
        };
        object.worker = Some(object.begin()?);
        Ok(object)
    }

    /// Returns the description of the object.
    pub fn about(&self) -> &About {
        &self.about
    }

    /// Calls the object with a value; `sample()` takes none. Blocks until the object has answered, the timeout is
    /// over, or the process has ended. After a failure the next call restarts the process.
    pub fn call(&mut self, parts: &[Part]) -> Called {
        let asked = self.clock.mono();
        let restarted = self.worker.is_none().then_some(asked);
        let answer = self.living().and_then(|mut worker| {
            let begun = self.clock.mono();
            let until = begun + milliseconds(self.config.timeout_ms.get());
            match worker.call(parts, until) {
                // A process is kept only after an answer: what is left in the pipe after a failure would be taken for
                // the answer to the next call.
                Ok(answer) => {
                    self.worker = Some(worker);
                    self.restarts.worked();
                    Ok((begun, answer))
                }
                Err(trouble) => Err(self.trouble(trouble, worker)),
            }
        });
        let ended = self.clock.mono();
        match answer {
            Ok((begun, (reply, bytes))) => {
                let mut called = self.called(reply, bytes, begun, ended);
                called.times.restarted = restarted;
                called
            }
            Err(error) => {
                if !matches!(error, PythonError::Resting { .. }) {
                    self.restarts.died(ended);
                    self.last = error.to_string();
                }
                Called { result: Err(error), times: Times::new(asked, ended, &[]) }
            }
        }
    }

    fn called(&mut self, reply: Reply, bytes: Vec<Bytes>, begun: MonoTime, ended: MonoTime) -> Called {
        let called =
            |result, stages: &[(Stage, i64, i64)]| Called { result, times: Times::new(begun, ended, stages) };
        match reply {
            Reply::Value { parts, stages } => {
                let parts = parts.into_iter().zip(bytes);
                let parts =
                    parts.map(|(head, bytes)| Part { description: head.description, bytes }).collect();
                called(Ok(Some(parts)), &stages)
            }
            Reply::Over { stages } => called(Ok(None), &stages),
            Reply::Raised { text, stages } => called(Err(PythonError::Raised(text)), &stages),
            Reply::Refused { text, stages } => called(Err(PythonError::Value(text)), &stages),
            Reply::Ready(_) => {
                self.worker = None;
                called(Err(self.garbled(FrameError::ReadyTwice)), &[])
            }
        }
    }

    /// Returns the running process, or a new one if the last has died and its delay is over.
    fn living(&mut self) -> Result<Worker, PythonError> {
        if let Some(worker) = self.worker.take() {
            return Ok(worker);
        }
        if let Some(left) = self.restarts.wait(self.clock.mono()) {
            return Err(PythonError::Resting {
                object: self.config.object.clone(),
                left,
                last: self.last.clone(),
            });
        }
        tracing::info!(
            name = self.launch.name,
            object = self.config.object,
            "a Python process is started anew"
        );
        self.begin()
    }

    /// Starts a process and waits until the object is created.
    fn begin(&mut self) -> Result<Worker, PythonError> {
        let (module, path) = self.config.module_and_path()?;
        let allowed = milliseconds(self.config.start_timeout_ms.get());
        let until = self.clock.mono() + allowed;
        let mut worker = Worker::start(&self.launch, &self.clock)
            .map_err(|trouble| self.not_started(trouble.to_string()))?;
        let settings = Request::Start {
            module,
            path,
            role: self.role,
            pickle: self.config.pickle,
            images: self.config.images,
            window: worker.window(),
        };
        match worker.become_object(&settings, until) {
            Ok((Reply::Ready(about), _)) => {
                self.about = about;
                Ok(worker)
            }
            Ok((Reply::Raised { text, .. } | Reply::Refused { text, .. }, _)) => Err(self.not_started(text)),
            Ok(_) => Err(self.not_started("it answers before it was asked".to_owned())),
            Err(Trouble::Process(ProcessError::TimedOut)) => {
                let (allowed, last_words) = (allowed.seconds(), worker.kill().last_words());
                Err(self.not_started(format!(
                    "it was not ready within {allowed} s and was killed{last_words}; raise start_timeout_ms when it needs \
                     longer"
                )))
            }
            Err(trouble) => Err(self.not_started(trouble.to_string())),
        }
    }

    fn not_started(&self, reason: String) -> PythonError {
        let python = self.launch.program.to_string_lossy().into_owned();
        PythonError::Start { object: self.config.object.clone(), python, reason }
    }

    /// Converts the failure of a call after which the process cannot be used any more.
    fn trouble(&self, trouble: Trouble, worker: Worker) -> PythonError {
        let object = self.config.object.clone();
        match trouble {
            Trouble::Process(ProcessError::Ended(ended)) => PythonError::Died { object, ended },
            Trouble::Process(ProcessError::TimedOut) => PythonError::TooSlow {
                object,
                after: milliseconds(self.config.timeout_ms.get()),
                last_words: worker.kill().last_words(),
            },
            Trouble::Process(error) => PythonError::Process(error),
            Trouble::Garbled(source) => self.garbled(source),
            Trouble::Memory(error) => PythonError::Memory { object, error },
        }
    }

    fn garbled(&self, source: FrameError) -> PythonError {
        PythonError::Garbled { object: self.config.object.clone(), source }
    }
}

impl Drop for PythonObject {
    fn drop(&mut self) {
        if let Some(worker) = self.worker.take() {
            let ended = worker.end(GRACE);
            if !ended.as_asked() {
                tracing::warn!(name = self.launch.name, "at its end, {ended}");
            }
        }
    }
}

fn milliseconds(number: u64) -> Span {
    Span::from_millis(number.cast_signed())
}
