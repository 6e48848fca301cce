//! The one place that writes to the terminal; everything else goes through the log.

use std::borrow::Cow;
use std::fmt::Display;
use std::io::{self, ErrorKind, Write};
use std::sync::atomic::{AtomicBool, Ordering};

use clap::error::{ContextKind, ContextValue};

use crate::exit::{Exit, Failure};
use crate::short;

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
pub fn explain(error: clap::Error) -> Exit {
    let error = with_short_values(error);
    let plain = error.render().to_string();
    if error.use_stderr() {
        match short::lines(&plain) {
            // There is no third place to say that standard error cannot be written to.
            Cow::Borrowed(_) => drop(error.print()),
            // Whoever judged the value has repeated it.
            Cow::Owned(short) => complain(short.trim_end()),
        }
        return Exit::Usage;
    }
    note(error.print().and_then(|()| io::stdout().flush()).or_else(unless_gone));
    end(Ok(()))
}

/// The error with what the user has typed as far as people read it.
fn with_short_values(mut error: clap::Error) -> clap::Error {
    let short = |(kind, value): (ContextKind, &ContextValue)| match value {
        ContextValue::String(typed) => match short::value(typed) {
            short if short == *typed => None,
            short => Some((kind, ContextValue::String(short.into_owned()))),
        },
        _ => None,
    };
    let shortened: Vec<(ContextKind, ContextValue)> = error.context().filter_map(short).collect();
    for (kind, value) in shortened {
        error.insert(kind, value);
        // It repeats the value.
        error.remove(ContextKind::Suggested);
    }
    error
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

/// What went wrong, on standard error, before or after the log exists; of overlong lines not the middle.
pub fn complain(text: impl Display) {
    // There is no third place to say that standard error cannot be written to.
    let _ = write(&mut io::stderr().lock(), &short::lines(&text.to_string()));
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
    use clap::{Arg, Command};

    use super::*;

    #[test]
    fn what_was_typed_is_echoed_in_one_line_and_short() {
        let refused = |text: &str| Err::<String, _>(format!("{text:?} is none"));
        let command = Command::new("peernet").arg(Arg::new("set").long("set").value_parser(refused));
        let told = |word: &str| {
            let error = command.clone().try_get_matches_from(["peernet", word]).expect_err(word);
            short::lines(&with_short_values(error).render().to_string()).into_owned()
        };
        let text = format!("a.b=\u{1b}[31m\n{}\nthe end", "x = 1\n".repeat(10_000));
        let value = told(&format!("--set={text}"));
        let first = value.lines().next().expect("a line");
        assert!(first.starts_with("error: invalid value 'a.b= [31m x = 1"), "{value}");
        assert!(first.contains("the end' for '--set <set>': "), "{value}");
        assert!(value.len() < 1200 && value.lines().count() < 5, "{value}");
        let argument = told(&format!("--{text}"));
        assert!(argument.starts_with("error: unexpected argument '--a.b"), "{argument}");
        assert!(argument.len() < 1200 && argument.lines().count() < 9, "{argument}");
        assert!(told("--sett=1").contains("'--set'"), "what fits is said as the parser has it");
    }

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
