//! A running program that answers requests and is restarted after failures.

use bytes::Bytes;
use peernet_clock::{MonoTime, SharedClock, Span};
use peernet_sample::Part;

use super::text_line::shorten;
use super::{
    AssemblyStep, ExecConfig, MAX_LINE_BYTES, ProgramCallError, Reply, ReplyAssembler, ReplyNotes,
    ReplyOutcome, Request, Role, VERSION,
};
use crate::process::{Launch, Process, ProcessError, RestartBackoff, STOP_TIMEOUT, StderrLog};

/// External program in one role. All calls block.
#[derive(Debug)]
pub struct Program {
    role: Role,
    launch: Launch,
    timeout: Span,
    clock: SharedClock,
    /// `None` after a failure, until the program is restarted.
    process: Option<Process>,
    restart_backoff: RestartBackoff,
    /// `true` after a sensor has reported that it has no more samples. The sensor is not asked again.
    is_finished: bool,
}

/// A request to the program and its reply.
#[derive(Clone, Debug, PartialEq)]
pub struct ProgramCall {
    /// Time at which the restart of the program for this request began; `None` if it was already running.
    pub restart_began_at: Option<MonoTime>,
    /// Time at which writing the request began.
    pub started_at: MonoTime,
    /// Time at which the reply was complete.
    pub ended_at: MonoTime,
    /// Notes that preceded the reply.
    pub notes: ReplyNotes,
    /// Result of the request; never [`ReplyOutcome::Error`].
    pub outcome: ReplyOutcome,
}

impl Program {
    /// Starts the program. `name` is the owner of the program in log messages, such as `model quality-control`.
    ///
    /// # Errors
    /// If the configuration is wrong or the system cannot start the program.
    pub fn start(
        config: &ExecConfig,
        role: Role,
        name: &str,
        clock: &SharedClock,
    ) -> Result<Self, ProgramCallError> {
        config.check_for(role)?;
        let (program, arguments) = config.program_and_arguments();
        let mut environment = config.env.clone();
        environment.insert("PEERNET_EXEC".to_owned(), VERSION.to_string());
        environment.insert("PEERNET_ROLE".to_owned(), role.word().to_owned());
        let launch = Launch {
            name: name.to_owned(),
            stderr_log: StderrLog::Exec,
            program: program.into(),
            arguments: arguments.into_iter().map(Into::into).collect(),
            folder: config.folder.clone(),
            environment,
            inherited_file: None,
        };
        let process = Process::start(&launch, clock).map_err(ProgramCallError::Start)?;
        Ok(Self {
            role,
            launch,
            timeout: config.timeout(),
            clock: SharedClock::clone(clock),
            process: Some(process),
            restart_backoff: RestartBackoff::default(),
            is_finished: false,
        })
    }

    /// Sends a request and waits for the reply.
    ///
    /// If the program ended, exceeded its timeout or did not follow the framing, it is killed, and a later request
    /// starts it again.
    ///
    /// # Errors
    /// The reason that this request has no reply. The next request may succeed.
    pub fn call(&mut self, request: Request<'_>) -> Result<ProgramCall, ProgramCallError> {
        // Partial answers are dropped; `true` says that the caller still waits for the answer.
        self.call_with_partial_answers(request, &mut |_| true)
    }

    /// Sends a request as [`call`](Self::call) does, and passes each partial answer of a model to `on_partial_answer`
    /// when it arrives. `on_partial_answer` returns whether somebody still waits for the answer. If nobody waits, the
    /// program is killed. The timeout begins again with each partial answer.
    ///
    /// # Errors
    /// As [`call`](Self::call), and [`ProgramCallError::Cancelled`] if `on_partial_answer` returns `false`.
    pub fn call_with_partial_answers(
        &mut self,
        request: Request<'_>,
        on_partial_answer: &mut dyn FnMut(Part) -> bool,
    ) -> Result<ProgramCall, ProgramCallError> {
        if self.is_finished {
            let now = self.clock.mono();
            let notes = ReplyNotes::default();
            return Ok(ProgramCall {
                restart_began_at: None,
                started_at: now,
                ended_at: now,
                notes,
                outcome: ReplyOutcome::End,
            });
        }
        let restart_began_at = self.process.is_none().then(|| self.clock.mono());
        let mut process = match self.process.take() {
            Some(process) => process,
            None => self.restart()?,
        };
        let started_at = self.clock.mono();
        let new_deadline = || self.clock.mono() + self.timeout;
        let result = send_and_receive(&mut process, request, self.role, &new_deadline, on_partial_answer);
        let ended_at = self.clock.mono();
        match result {
            Ok(Reply { notes, outcome }) => {
                self.process = Some(process);
                // For the restart delay, a reply that reports an error is a success: the program follows the framing
                // and still runs.
                self.restart_backoff.record_success();
                self.is_finished = outcome == ReplyOutcome::End;
                match outcome {
                    ReplyOutcome::Error(text) => Err(ProgramCallError::ErrorReply(text)),
                    outcome => Ok(ProgramCall { restart_began_at, started_at, ended_at, notes, outcome }),
                }
            }
            Err(error) => {
                // Dropping `process` kills the program. This happens before the restart delay begins, so that the
                // program has ended when the next process starts.
                let error = match error {
                    // The program has not failed, so its restart is not delayed.
                    ProgramCallError::Cancelled => {
                        drop(process);
                        return Err(error);
                    }
                    ProgramCallError::Process(ProcessError::TimedOut) => ProgramCallError::TooSlow {
                        timeout: self.timeout.to_duration(),
                        stderr_suffix: process.kill().stderr_suffix(),
                    },
                    error => {
                        drop(process);
                        error
                    }
                };
                Err(self.record_failure(error))
            }
        }
    }

    /// Prepares a sensor or an actuator for an episode.
    ///
    /// # Errors
    /// As [`call`](Self::call); a later reset may succeed.
    pub fn reset(&mut self) -> Result<(), ProgramCallError> {
        self.call(Request::Reset).map(drop)
    }

    fn restart(&mut self) -> Result<Process, ProgramCallError> {
        if let Some((remaining_delay, last_failure)) = self.restart_backoff.remaining_delay(self.clock.mono())
        {
            let (remaining_delay, last_failure) = (remaining_delay.to_duration(), last_failure.to_owned());
            return Err(ProgramCallError::RestartDelayed { remaining_delay, last_failure });
        }
        tracing::info!(name = self.launch.name, "restarting the program");
        Process::start(&self.launch, &self.clock)
            .map_err(|error| self.record_failure(ProgramCallError::Start(error)))
    }

    /// Records a failure, so that the next restart is delayed. Returns the error.
    fn record_failure(&mut self, error: ProgramCallError) -> ProgramCallError {
        self.restart_backoff.record_failure(self.clock.mono(), &error);
        error
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        if let Some(process) = self.process.take() {
            let end = process.end(STOP_TIMEOUT);
            tracing::debug!(name = self.launch.name, ended = %end, "stopped the program");
        }
    }
}

/// Sends a request and reads the reply.
fn send_and_receive(
    process: &mut Process,
    request: Request<'_>,
    role: Role,
    new_deadline: &dyn Fn() -> MonoTime,
    on_partial_answer: &mut dyn FnMut(Part) -> bool,
) -> Result<Reply, ProgramCallError> {
    let mut deadline = new_deadline();
    // Output that precedes the request would be mistaken for the reply to this request. From then on, each reply would
    // be mistaken for the reply to the next request.
    if process.has_unread_output() {
        return Err(ProgramCallError::UnsolicitedOutput(shorten(&process.peek_line())));
    }
    let pieces = request.pieces();
    let slices: Vec<&[u8]> = pieces.iter().map(Bytes::as_ref).collect();
    process.write(&slices, deadline)?;
    let mut assembler = match request {
        Request::Reset => ReplyAssembler::for_reset(role),
        _ => ReplyAssembler::new(role),
    };
    let mut step = AssemblyStep::ReadLine;
    loop {
        step = match step {
            AssemblyStep::ReadLine => assembler.push_line(&process.read_line(MAX_LINE_BYTES, deadline)?)?,
            AssemblyStep::DeliverPartialAnswer(part) => {
                if !on_partial_answer(part) {
                    return Err(ProgramCallError::Cancelled);
                }
                deadline = new_deadline();
                AssemblyStep::ReadLine
            }
            // An empty part needs no read.
            AssemblyStep::ReadBytes(0) => assembler.push_bytes(Bytes::new()),
            // The count is at most `MAX_SAMPLE_BYTES`, which fits into a usize.
            AssemblyStep::ReadBytes(count) => {
                let announced = count as usize;
                let bytes = process.read_exact(announced, deadline).map_err(|error| match error {
                    ProcessError::ProcessEnd(end) => {
                        ProgramCallError::Incomplete { received: process.received_bytes(), announced, end }
                    }
                    error => error.into(),
                });
                assembler.push_bytes(bytes?)
            }
            AssemblyStep::Complete(reply) => return Ok(reply),
        }
    }
}

#[cfg(test)]
mod tests;
