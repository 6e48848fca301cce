//! What can go wrong with a program.

use std::num::NonZeroU64;
use std::path::PathBuf;
use std::time::Duration;

use super::{MAX_BYTES, MAX_LINES, MAX_PARTS, VERSION};
use crate::process::{MAX_TIMEOUT_MS, ProcessError};

/// A reply that does not follow the framing. The program is stopped then: where its next message begins is unknown.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FramingError {
    /// A line that is not UTF-8.
    #[error("it wrote {0:?}, which is not UTF-8 text; write what is not for peernet to standard error")]
    NotText(String),
    /// A first word that means nothing here.
    #[error(
        "it wrote {line:?}; a {role} writes one of: {words}. Write what is not for peernet to standard error"
    )]
    Word {
        /// The line.
        line: String,
        /// What the program is used as.
        role: &'static str,
        /// The words that it may begin a line with.
        words: String,
    },
    /// A known word with the wrong words after it.
    #[error("it wrote {line:?}; write it as: {form}")]
    Form {
        /// The line.
        line: String,
        /// The right form.
        form: &'static str,
    },
    /// A payload beyond the limit.
    #[error("it announced {0} bytes; a sample has at most {MAX_BYTES}")]
    TooLarge(u64),
    /// A payload that does not have the length that its shape says.
    #[error("it announced {bytes} bytes for a shape of {expected}")]
    Shape {
        /// What was announced.
        bytes: u64,
        /// What the shape needs.
        expected: u64,
    },
    /// Too many lines before the reply was whole.
    #[error("it wrote more than {MAX_LINES} lines for one reply")]
    TooManyLines,
    /// Too many parts.
    #[error("it announced more than {MAX_PARTS} parts of one sample")]
    TooManyParts,
    /// A name that is not the program's to use.
    #[error(
        "it reported {0:?}, which is not its to measure; use another name, or as a model the stages preprocessing, inference, \
         postprocessing"
    )]
    Name(String),
    /// A framing that this program does not know.
    #[error("it speaks version {0} of the framing; this peernet speaks version {VERSION}")]
    Version(u32),
}

/// A command that cannot be run, found without running it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CommandError {
    /// Longer than any reply may take.
    #[error("timeout_ms = {timeout_ms} is too much; at most {MAX_TIMEOUT_MS}")]
    Timeout {
        /// The configured time in milliseconds.
        timeout_ms: NonZeroU64,
    },
    /// The folder to run it in is not there.
    #[error("{} is not a folder to run it in", .0.display())]
    NotAFolder(PathBuf),
    /// The system takes no environment variable of this name or value.
    #[error("{0:?} cannot be given to it as an environment variable")]
    Variable(String),
    /// There is nothing to run.
    #[error("an empty command runs nothing")]
    Empty,
    /// The system ends each word at its first zero byte.
    #[error("the command of {program:?} contains a zero byte")]
    ZeroByte {
        /// The first word.
        program: String,
    },
    /// There is no file at the path of the program.
    #[error("there is no program {}", .0.display())]
    NoFile(PathBuf),
    /// The program is not in the folders of `PATH`.
    #[error("there is no program {0} in the folders of PATH")]
    NotInPath(String),
}

/// Why a program gave no reply to a request.
#[derive(Debug, thiserror::Error)]
pub enum ExchangeError {
    /// The command cannot be run.
    #[error(transparent)]
    Command(#[from] CommandError),
    /// The program said so: it goes on as it is.
    #[error("the program says: {0}")]
    Refused(String),
    /// It could not be started.
    #[error("{0}")]
    Start(ProcessError),
    /// It ended, or its pipe failed.
    #[error("{0}; it is started anew")]
    Process(#[from] ProcessError),
    /// It did not keep to the framing.
    #[error("{0} (it is stopped and started anew; docs/external-programs.md describes the framing)")]
    Framing(#[from] FramingError),
    /// It wrote more than its reply.
    #[error(
        "it wrote {0:?} before it was asked: one reply for each request, and nothing else, goes to standard output (it is \
         stopped and started anew)"
    )]
    Unasked(String),
    /// It took longer than it may.
    #[error(
        "it gave no whole reply within {after:?}{last_words}; it is killed and started anew (timeout_ms sets how long it \
         may take)"
    )]
    TooSlow {
        /// How long it had.
        after: Duration,
        /// The last lines of its standard error, in words; may be empty.
        last_words: String,
    },
    /// It failed several times in a row, and is not started again at once.
    #[error("it failed again and again; it is started anew in {left:.1?}; the last time {last}")]
    Pausing {
        /// How long it is left alone.
        left: Duration,
        /// Why it failed last.
        last: String,
    },
    /// Its stages take longer than it took.
    #[error(
        "the stages that it reported add up to {stages:?}, but it replied within {whole:?}; report seconds"
    )]
    Stages {
        /// Sum of its stages.
        stages: Duration,
        /// From the request to the reply.
        whole: Duration,
    },
}
