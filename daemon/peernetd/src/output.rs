//! The one place that writes to the terminal; everything else goes through the log.

use std::fmt::Display;
use std::io::{self, ErrorKind, Write};
use std::sync::atomic::{AtomicBool, Ordering};

use crate::exit::{Exit, Failure};

/// Whether a part of the result could not be written.
static UNWRITTEN: AtomicBool = AtomicBool::new(false);

/// A result that the user asked for, on standard output.
///
/// When nobody reads any more, as `head` after its lines, the rest goes nowhere: the exit code still tells how it went.
/// Any other trouble is told once, and by the exit code ([`end`]).
pub fn say(text: impl Display) {
    note(write(&mut io::stdout().lock(), &text));
}

/// What the command line's parser has to say, to whom it is for: help that was asked for, or what is wrong (64).
pub fn explain(error: &clap::Error) -> Exit {
    let printed = error.print().and_then(|()| io::stdout().flush()).or_else(unless_gone);
    if error.use_stderr() {
        // There is no third place to say that standard error cannot be written to.
        return Exit::Usage;
    }
    note(printed);
    end(Ok(()))
}

/// How the program is to end: as it went, or 73 when all went well but the result could not be written.
pub fn end(done: Result<(), Failure>) -> Exit {
    match done {
        Ok(()) => kept(Exit::Ok),
        Err(failure) => {
            complain(&failure);
            failure.exit
        }
    }
}

/// An end, unless it is a good one and the result could not be written (73).
pub fn kept(exit: Exit) -> Exit {
    if exit == Exit::Ok && UNWRITTEN.load(Ordering::Relaxed) { Exit::Unwritten } else { exit }
}

fn note(written: io::Result<()>) {
    let Err(error) = written else { return };
    if !UNWRITTEN.swap(true, Ordering::Relaxed) {
        complain(format_args!("cannot write the result: {error}"));
    }
}

/// What went wrong, on standard error, before or after the log exists.
pub fn complain(text: impl Display) {
    // There is no third place to say that standard error cannot be written to.
    let _ = write(&mut io::stderr().lock(), &text);
}

/// A line; a reader that has gone is no error.
fn write(stream: &mut impl Write, text: &dyn Display) -> io::Result<()> {
    let written = writeln!(stream, "{text}").and_then(|()| stream.flush());
    written.or_else(unless_gone)
}

fn unless_gone(error: io::Error) -> io::Result<()> {
    if error.kind() == ErrorKind::BrokenPipe { Ok(()) } else { Err(error) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reader_that_has_gone_is_no_error() {
        let (reader, mut writer) = io::pipe().expect("a pipe");
        drop(reader);
        assert_eq!(writer.write_all(b"x").map_err(|error| error.kind()), Err(ErrorKind::BrokenPipe));
        assert!(write(&mut writer, &"a result").is_ok());
        let mut full = std::fs::OpenOptions::new().write(true).open("/dev/full").expect("there is one");
        assert_eq!(write(&mut full, &"a result").map_err(|error| error.kind()), Err(ErrorKind::StorageFull));
    }
}
