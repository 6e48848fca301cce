//! Errors of external programs.

use std::num::NonZeroU64;
use std::path::PathBuf;
use std::time::Duration;

use super::{MAX_LINES, MAX_PARTS, MAX_SAMPLE_BYTES, VERSION};
use crate::process::{MAX_TIMEOUT_MS, ProcessEnd, ProcessError};

/// Reply that does not follow the framing.
// The program is killed, because the start of its next message cannot be found.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FramingError {
    /// The line is not UTF-8.
    #[error(
        "it wrote {0:?}, which is not UTF-8 text; write only replies to standard output, and everything else to standard error"
    )]
    NotText(String),
    /// The first word of the line has no meaning for this role.
    #[error(
        "it wrote {line:?}; {role} writes one of: {words}. Write only replies to standard output, and everything else to \
         standard error"
    )]
    Word {
        /// The line.
        line: String,
        /// Role of the program, with its article.
        role: &'static str,
        /// Words that a line may begin with.
        words: String,
    },
    /// The words after a known first word are wrong.
    #[error("it wrote {line:?}; write it as: {form}")]
    Form {
        /// The line.
        line: String,
        /// The expected form.
        form: &'static str,
    },
    /// The sample or answer is larger than the limit.
    #[error("it announced {0} bytes; a sample or answer has at most {MAX_SAMPLE_BYTES}")]
    TooLarge(u64),
    /// The length of a part does not match the part's shape.
    #[error("it announced {bytes} bytes, but its shape and type need {expected} bytes")]
    Shape {
        /// Announced length, bytes.
        bytes: u64,
        /// Length according to the shape, bytes.
        expected: u64,
    },
    /// The reply has too many lines.
    #[error("it wrote more than {MAX_LINES} lines for one reply")]
    TooManyLines,
    /// The sample or answer has too many parts.
    #[error("it announced more than {MAX_PARTS} parts of one sample or answer")]
    TooManyParts,
    /// The name of a reported stage or value is reserved.
    #[error(
        "it reported {0:?}, which is a reserved name; use another name; a model may report the stages preprocessing, \
         inference and postprocessing"
    )]
    Name(String),
    /// The name belongs to feedback, which an actuator reports with a separate line.
    #[error("it reported {name:?}, which is a reserved name; an actuator writes the line: {form}")]
    FeedbackName {
        /// The name.
        name: String,
        /// Form of the line.
        form: &'static str,
    },
    /// A reply contains a line twice that it may contain only once.
    #[error("it wrote the line {0} more than once in one reply; write it once")]
    Repeated(&'static str),
    /// The program uses an unknown version of the framing.
    #[error("it uses version {0} of the framing; this peernet supports version {VERSION}")]
    Version(u32),
}

/// Reason why a command cannot be run, found without running it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CommandError {
    /// The timeout is longer than allowed.
    #[error("timeout_ms = {timeout_ms} is above the limit of {MAX_TIMEOUT_MS}")]
    Timeout {
        /// The configured timeout, milliseconds.
        timeout_ms: NonZeroU64,
    },
    /// A model cannot be reset.
    #[error("resets = true is for sensors and actuators; a model has no episodes")]
    ModelResets,
    /// The working directory does not exist.
    #[error("its working directory {} is not a folder", .0.display())]
    NotAFolder(PathBuf),
    /// The system cannot pass an environment variable with this name or value.
    #[error("the environment variable {0:?} has an invalid name or value")]
    Variable(String),
    /// The command is empty.
    #[error("the command is empty")]
    Empty,
    /// A word of the command contains a zero byte. The system would end the word there.
    #[error("the command of {program:?} contains a zero byte")]
    ZeroByte {
        /// The first word of the command.
        program: String,
    },
    /// The path of the program leads to no file.
    #[error("there is no program {}; correct its path, which is relative to the value of the key `folder`", .0.display())]
    NoFile(PathBuf),
    /// The file of the program cannot be executed.
    #[error("the program {path} is not executable; run chmod +x {path}", path = .0.display())]
    NotExecutable(PathBuf),
    /// The program is not in the folders of `PATH`.
    #[error("there is no program {0} in the folders of PATH; install it, or write its path")]
    NotInPath(String),
}

/// Reason that a request to a program failed.
#[derive(Debug, thiserror::Error)]
pub enum ProgramCallError {
    /// The request was cancelled; the program was killed.
    #[error("nobody waits for the answer any more; the program was killed")]
    Cancelled,
    /// The command cannot be run.
    #[error(transparent)]
    Command(#[from] CommandError),
    /// The program replied with an error and still runs.
    #[error("{}", error_reply_text(.0))]
    ErrorReply(String),
    /// The program cannot be started.
    #[error("{0}")]
    Start(ProcessError),
    /// The program ended, or its pipe failed.
    #[error("{0}; it is restarted")]
    Process(#[from] ProcessError),
    /// The program ended in the middle of a payload.
    #[error("it announced {announced} bytes, but had sent only {received} bytes when {end}; it is restarted")]
    Incomplete {
        /// Number of bytes that arrived.
        received: usize,
        /// Number of bytes that it announced.
        announced: usize,
        /// End of the process.
        end: ProcessEnd,
    },
    /// The program did not follow the framing.
    #[error("{0} (it is killed and restarted; docs/external-programs.md describes the framing)")]
    Framing(#[from] FramingError),
    /// The program wrote output before a request.
    #[error(
        "it wrote {0:?} without a request; write one reply for each request, and nothing else, to standard output (it is \
         killed and restarted)"
    )]
    UnsolicitedOutput(String),
    /// The program did not reply before its timeout.
    #[error(
        "it gave no complete reply within {timeout:?}{stderr_suffix}; it is killed and restarted (timeout_ms, or --timeout of \
         peernet --server, sets the time limit)"
    )]
    TooSlow {
        /// The timeout.
        timeout: Duration,
        /// The last lines of its standard error as a suffix for a message; may be empty.
        stderr_suffix: String,
    },
    /// The program failed several times in a row and is not restarted yet.
    #[error("it failed repeatedly; it is restarted in {remaining_delay:.1?}; last failure: {last_failure}")]
    RestartDelayed {
        /// Time until the next start.
        remaining_delay: Duration,
        /// Text of the last failure.
        last_failure: String,
    },
    /// The sum of the reported stages is longer than the whole call.
    #[error(
        "the stages that it reported add up to {stages:?}, but it replied within {call:?}; if the program \
         rounds its durations up, let it report seconds with at least six decimals"
    )]
    StagesTooLong {
        /// Sum of the stages.
        stages: Duration,
        /// Time from the request to the reply.
        call: Duration,
    },
    /// A reported stage is longer than the whole call.
    #[error(
        "the stage {name} that it reported takes {stage:?}, but it replied within {call:?}; if the program \
         rounds its durations up, let it report seconds with at least six decimals"
    )]
    StageTooLong {
        /// Name of the stage.
        name: String,
        /// Duration of the stage.
        stage: Duration,
        /// Time from the request to the reply.
        call: Duration,
    },
}

/// Returns the message about a reply that reports an error.
fn error_reply_text(text: &str) -> String {
    if text.trim().is_empty() {
        "the program reported an error without a text; write its reason as: error TEXT".to_owned()
    } else {
        format!("the program says: {text}")
    }
}
