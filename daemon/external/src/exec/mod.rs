//! External programs: any program that reads lines from standard input and writes lines to standard output.
//!
//! docs/external-programs.md describes the framing (version [`VERSION`]) for authors of such programs. A message is a
//! line of words that ends with `\n`; some lines announce a number of bytes that follow:
//!
//! ```text
//! to a sensor     next
//! to a model      sample BYTES MEDIA-TYPE SHAPE SOURCE, bytes
//! to an actuator  answer BYTES MEDIA-TYPE SHAPE SOURCE, bytes
//! from a sensor   answer BYTES [MEDIA-TYPE [SHAPE]], bytes | end | error TEXT
//! from a model    answer BYTES [MEDIA-TYPE [SHAPE]], bytes | partial BYTES [MEDIA-TYPE [SHAPE]], bytes | error TEXT
//! from an actuator  done | error TEXT
//! ```
//!
//! A sensor, like a model, begins its reply with the word `answer`. PEERNet may send `reset` to a sensor or an actuator
//! before an episode; the program replies with `done | error TEXT`.
//!
//! `part` instead of `sample` or `answer` announces that another part of the same sample or answer follows. `partial`
//! announces a partial answer: the whole answer follows later. Before its reply a program may write lines that begin
//! with `version`, `stage` or `value`, a sensor also with `sequence`, `label` or `source`, and an actuator with
//! `reward`, `success` or `episode-ended`.

mod arguments;
mod command;
mod error;
mod program;
mod reply;
mod request;
mod shape;
mod shell;
mod text_line;
mod timeline;

pub use arguments::{FingerprintKey, hide_arguments, hide_arguments_in_facts, with_arguments};
pub use command::{CommandLine, ExecConfig};
pub use error::{CommandError, FramingError, ProgramCallError};
pub use program::{Program, ProgramCall};
pub use reply::{AssemblyStep, Reply, ReplyAssembler, ReplyNotes, ReplyOutcome};
pub use request::Request;
pub use timeline::TimedStage;

pub use crate::role::Role;

/// Version of the framing.
pub const VERSION: u32 = 1;

/// Longest line of a program, bytes, without the line feed.
pub const MAX_LINE_BYTES: usize = 4096;
/// Maximum number of lines in one reply.
// A program that writes notes without end would otherwise fill the memory.
pub const MAX_LINES: usize = 256;
/// Maximum number of parts of one sample or answer.
pub const MAX_PARTS: usize = 16;
/// Largest size of one sample or answer, bytes (1 GiB).
pub const MAX_SAMPLE_BYTES: u64 = 1 << 30;
