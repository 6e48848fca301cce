//! External programs: any program that reads lines on standard input and writes lines on standard output.
//!
//! The framing (version [`VERSION`]) is described for those who write such programs in docs/external-programs.md.
//! A message is a line of words that ends with `\n`; some are followed by as many bytes as the line says:
//!
//! ```text
//! to a sensor     next
//! to a model      sample BYTES MEDIA-TYPE SHAPE SOURCE, bytes
//! to an actuator  answer BYTES MEDIA-TYPE SHAPE SOURCE, bytes
//! from a sensor   answer BYTES [MEDIA-TYPE [SHAPE]], bytes | end | error TEXT
//! from a model    answer BYTES [MEDIA-TYPE [SHAPE]], bytes | error TEXT
//! from an actuator  done | error TEXT
//! ```
//!
//! `part` instead of `sample` or `answer` announces that another part of the same sample follows. Before its reply a
//! program may say `version`, `stage`, `value`, `sequence`, `label` and `source`.

mod arguments;
mod command;
mod error;
mod program;
mod reply;
mod request;
mod shape;
mod shell;
mod timeline;
mod words;

pub use arguments::{FingerprintKey, hide_arguments, hide_arguments_in_facts, with_arguments};
pub use command::{CommandLine, ExecConfig};
pub use error::{CommandError, ExchangeError, FramingError};
pub use program::{Exchange, Program};
pub use reply::{Assembler, Next, Notes, Reply, Said};
pub use request::Request;
pub use timeline::Timed;

/// Version of the framing.
pub const VERSION: u32 = 1;

/// Longest line of a program, without its end.
pub const MAX_LINE: usize = 4096;
/// Most lines of one reply.
pub const MAX_LINES: usize = 256;
/// Most parts of one sample.
pub const MAX_PARTS: usize = 16;
/// Most bytes of one sample: 1 GiB.
pub const MAX_BYTES: u64 = 1 << 30;

/// What a program is used as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Yields samples.
    Sensor,
    /// Answers samples.
    Model,
    /// Acts on answers.
    Actuator,
}

impl Role {
    /// The word for it: in the program's environment and in messages for people.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Sensor => "sensor",
            Self::Model => "model",
            Self::Actuator => "actuator",
        }
    }

    /// The word at the beginning of facts.
    const fn heading(self) -> &'static str {
        match self {
            Self::Sensor => "Sensor",
            Self::Model => "Model",
            Self::Actuator => "Actuator",
        }
    }
}
