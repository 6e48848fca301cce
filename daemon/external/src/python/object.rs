//! A custom object and the process in which it runs.

use peernet_clock::{MonoTime, SharedClock, Span};
use peernet_sample::Part;

use super::frame::{self, FrameError, Reply, Request};
use super::interpreter;
use super::worker::{ReplyWithBytes, Worker, WorkerError};
use super::{CallResult, CallTimes, ObjectDescription, PythonConfig, PythonError, Role};
use crate::process::{Launch, ProcessError, RestartBackoff, STOP_TIMEOUT};

/// Time from the start of a process to the first log line that says that the object is not created yet. Each further
/// line follows after twice the time of the previous line.
const FIRST_REPORT_AFTER: Span = Span::from_millis(30_000);

/// Python object in a separate process, which is restarted when it dies. Dropping it ends the process.
#[derive(Debug)]
pub struct PythonObject {
    config: PythonConfig,
    role: Role,
    launch: Launch,
    clock: SharedClock,
    description: ObjectDescription,
    /// `None` after a failure, until a call starts a new process.
    worker: Option<Worker>,
    restart_backoff: RestartBackoff,
}

impl PythonObject {
    /// Checks whether an object exists without running any custom code: its name, folder and interpreter, and whether
    /// Python finds the module. Blocks for some tens of milliseconds.
    ///
    /// # Errors
    /// The first failed check.
    pub fn check(config: &PythonConfig, clock: &SharedClock) -> Result<(), PythonError> {
        interpreter::check(config, clock)
    }

    /// Starts the process, imports the module and creates the object; blocks until that is done.
    ///
    /// `name` is the owner of the process in log messages; `device` becomes the environment variable `PEERNET_DEVICE`.
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
            description: ObjectDescription::default(),
            worker: None,
            restart_backoff: RestartBackoff::default(),
        };
        object.worker = Some(object.start_worker()?);
        Ok(object)
    }

    /// Returns the description of the object.
    pub fn description(&self) -> &ObjectDescription {
        &self.description
    }

    /// Calls the object with a value; `sample()` takes no value. Blocks until the object has answered, the timeout is
    /// over, or the process has ended.
    ///
    /// If the process died or did not answer, the next call restarts the process. After repeated failures the restart
    /// is delayed, and calls fail until the delay is over. An exception of custom code does not end the process.
    pub fn call(&mut self, parts: &[Part]) -> CallResult {
        // Partial answers are ignored, and the object computes the whole answer.
        self.call_with_partial_answers(parts, &mut |_| true)
    }

    /// Calls a model as [`call`](Self::call) does, and passes each partial answer to `on_partial_answer`: each value
    /// that the generator `infer` yields. `on_partial_answer` returns whether somebody still waits for the answer. If
    /// it returns `false`, the object stops computing and the call fails. The timeout begins again with each partial
    /// answer.
    pub fn call_with_partial_answers(
        &mut self,
        parts: &[Part],
        on_partial_answer: &mut dyn FnMut(Vec<Part>) -> bool,
    ) -> CallResult {
        let clock = SharedClock::clone(&self.clock);
        let timeout = milliseconds(self.config.timeout_ms.get());
        self.send_and_receive(|worker, _| worker.call(parts, &|| clock.mono() + timeout, on_partial_answer))
    }

    /// Returns whether the object has `reset()`.
    pub fn resets(&self) -> bool {
        self.description.resets()
    }

    /// Calls `reset()` of the object, which prepares it for an episode. Blocks and restarts as [`call`](Self::call)
    /// does.
    ///
    /// # Errors
    /// If the object raised an exception, or the process gave no answer.
    pub fn reset(&mut self) -> Result<(), PythonError> {
        self.send_and_receive(Worker::reset).result.map(drop)
    }

    /// Returns whether the object is a sensor with `advance(seconds)`.
    pub fn advances(&self) -> bool {
        self.description.advances()
    }

    /// Calls `advance(seconds)` of the object, which advances a simulation. Blocks and restarts as
    /// [`call`](Self::call) does.
    ///
    /// # Errors
    /// If the object raised an exception, or the process gave no answer.
    pub fn advance(&mut self, time: Span) -> Result<(), PythonError> {
        self.send_and_receive(|worker, deadline| worker.advance(time, deadline)).result.map(drop)
    }

    /// Sends a request to the process and receives its reply.
    fn send_and_receive(
        &mut self,
        request: impl FnOnce(&mut Worker, MonoTime) -> Result<ReplyWithBytes, WorkerError>,
    ) -> CallResult {
        let called_at = self.clock.mono();
        let restart_began_at = self.worker.is_none().then_some(called_at);
        let answer = self.take_or_start_worker().and_then(|mut worker| {
            let started_at = self.clock.mono();
            let deadline = started_at + milliseconds(self.config.timeout_ms.get());
            let (reply, bytes) = match request(&mut worker, deadline) {
                Ok(answer) => answer,
                Err(failure) => return Err(self.call_error(failure, worker)),
            };
            let (result, steps) = match reply {
                Reply::Value { parts, steps } => (Ok(Some(frame::join_parts(parts, bytes))), steps),
                Reply::EndOfSamples { steps } => (Ok(None), steps),
                Reply::Raised { text, steps } => (Err(PythonError::Raised(text)), steps),
                Reply::UnsupportedValue { text, steps } => (Err(PythonError::Value(text)), steps),
                Reply::Ready(_) | Reply::PartialAnswer { .. } => {
                    return Err(self.invalid_message(FrameError::UnexpectedReply));
                }
            };
            // A process is used again only after an answer: after a failure, bytes in the pipe would be mistaken for the
            // answer to the next call.
            self.worker = Some(worker);
            self.restart_backoff.record_success();
            Ok((started_at, result, steps))
        });
        let ended_at = self.clock.mono();
        match answer {
            Ok((started_at, result, steps)) => {
                let times = CallTimes::new(started_at, ended_at, &steps);
                CallResult { result, times: CallTimes { restart_began_at, ..times } }
            }
            Err(error) => {
                // A call during the delay is no further failure and must not extend the delay.
                if !matches!(error, PythonError::RestartDelayed { .. }) {
                    self.restart_backoff.record_failure(ended_at, &error);
                }
                CallResult { result: Err(error), times: CallTimes::new(called_at, ended_at, &[]) }
            }
        }
    }

    /// Returns the running process, or starts a new process if the last one has died. Fails during the restart delay.
    fn take_or_start_worker(&mut self) -> Result<Worker, PythonError> {
        if let Some(worker) = self.worker.take() {
            return Ok(worker);
        }
        if let Some((remaining_delay, last_failure)) = self.restart_backoff.remaining_delay(self.clock.mono())
        {
            let (object, last_failure) = (self.config.object.clone(), last_failure.to_owned());
            return Err(PythonError::RestartDelayed { object, remaining_delay, last_failure });
        }
        tracing::info!(name = self.launch.name, object = self.config.object, "restarting a Python process");
        self.start_worker()
    }

    /// Starts a process and waits until the object is created.
    fn start_worker(&mut self) -> Result<Worker, PythonError> {
        let (module, path) = self.config.module_and_path()?;
        let timeout = milliseconds(self.config.start_timeout_ms.get());
        let deadline = self.clock.mono() + timeout;
        let mut worker = Worker::start(&self.launch, &self.clock)
            .map_err(|failure| self.start_error(failure.to_string()))?;
        let settings = Request::Start {
            module,
            path,
            role: self.role,
            pickle: self.config.pickle,
            images: self.config.images,
            shared_memory: worker.shared_memory_descriptor(),
        };
        let (name, object) = (&self.launch.name, &self.config.object);
        // The line has the same log target as the output of custom code, because `peernet run` shows this target.
        let mut report = |elapsed: Span| {
            tracing::warn!(
                target: "peernet_external::python",
                name,
                "{object} is not ready after {} s: its import or __init__ has not ended; it is killed after {} s (start_timeout_ms)",
                elapsed.seconds(),
                timeout.seconds()
            );
        };
        match worker.create_object(&settings, deadline, (&self.clock, FIRST_REPORT_AFTER), &mut report) {
            Ok((Reply::Ready(description), _)) => {
                self.description = description;
                Ok(worker)
            }
            Ok((Reply::Raised { text, .. }, _)) => Err(self.start_error(with_import_advice(&text))),
            Ok((Reply::UnsupportedValue { text, .. }, _)) => Err(self.start_error(text)),
            Ok(_) => Err(self.start_error("it answered before a request".to_owned())),
            Err(WorkerError::Process(ProcessError::TimedOut)) => {
                let (timeout_s, stderr_suffix) = (timeout.seconds(), worker.kill().stderr_suffix());
                Err(self.start_error(format!(
                    "it was not ready within {timeout_s} s and was killed{stderr_suffix}; raise start_timeout_ms if it needs \
                     longer"
                )))
            }
            Err(failure) => Err(self.start_error(failure.to_string())),
        }
    }

    fn start_error(&self, reason: String) -> PythonError {
        let python = self.launch.program.to_string_lossy().into_owned();
        PythonError::Start { object: self.config.object.clone(), python, reason }
    }

    /// Converts a failure after which the process cannot be used any more.
    fn call_error(&self, failure: WorkerError, worker: Worker) -> PythonError {
        let object = self.config.object.clone();
        match failure {
            WorkerError::Process(ProcessError::ProcessEnd(end)) => PythonError::Died { object, end },
            WorkerError::Process(ProcessError::TimedOut) => PythonError::TooSlow {
                object,
                timeout: milliseconds(self.config.timeout_ms.get()),
                stderr_suffix: worker.kill().stderr_suffix(),
            },
            WorkerError::Process(error) => PythonError::Process(error),
            WorkerError::InvalidMessage(source) => self.invalid_message(source),
            WorkerError::Memory(error) => PythonError::Memory { object, error },
        }
    }

    fn invalid_message(&self, source: FrameError) -> PythonError {
        PythonError::InvalidMessage { object: self.config.object.clone(), source }
    }
}

impl Drop for PythonObject {
    fn drop(&mut self) {
        if let Some(worker) = self.worker.take() {
            let end = worker.end(STOP_TIMEOUT);
            if !end.ended_as_requested() {
                tracing::warn!(name = self.launch.name, "the Python process did not exit cleanly: {end}");
            }
        }
    }
}

/// Returns the text of an exception. If custom code imports a missing module, the first line ends with advice.
fn with_import_advice(text: &str) -> String {
    if !text.starts_with("ModuleNotFoundError: ") {
        return text.to_owned();
    }
    let (exception, traceback) = text.split_once('\n').unwrap_or((text, ""));
    // Python's text ends like this if the name before the last dot is a module and no package, as in `module.Class`.
    if exception.ends_with(" is not a package") {
        return format!("{exception}; write two colons between module and object: module::Name\n{traceback}")
            .trim_end()
            .to_owned();
    }
    let advised_line = format!(
        "{exception}; install it for this interpreter, or name the interpreter that has it with the key python or the variable \
         PEERNET_PYTHON"
    );
    if traceback.is_empty() { advised_line } else { format!("{advised_line}\n{traceback}") }
}

fn milliseconds(number: u64) -> Span {
    Span::from_millis(number.cast_signed())
}
