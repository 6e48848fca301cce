//! Output to the terminal. Other modules write there through these functions only, except for the log, the progress bar
//! and the question whether an experiment is to start.

use std::borrow::Cow;
use std::fmt::Display;
use std::io::{self, ErrorKind, Write};
use std::sync::atomic::{AtomicBool, Ordering};

use clap::error::{ContextKind, ContextValue};

use crate::exit::{Exit, Failure};
use crate::short;

/// `true` if a part of the result could not be written.
static IS_OUTPUT_LOST: AtomicBool = AtomicBool::new(false);

/// Prints a result to standard output.
///
/// If the reader has closed the pipe, as `head` does after its lines, the rest is dropped without an error. Any other
/// error is printed once and changes the exit code ([`with_output_errors`]).
pub fn print_to_stdout(text: impl Display) {
    record_write(write(&mut io::stdout().lock(), &text));
}

/// Prints a message of the command line's parser and returns the exit code: 64 after an error, 0 after help
/// that was asked for.
pub fn report_parser_message(error: clap::Error) -> Exit {
    let error = with_short_values(error);
    let plain = error.render().to_string();
    if error.use_stderr() {
        match short::shorten_lines(&plain) {
            // If standard error cannot be written to, the error cannot be reported.
            Cow::Borrowed(_) => drop(error.print()),
            // The check of a value may repeat the value in its message, so the whole text is shortened. It loses its
            // colours.
            Cow::Owned(short) => print_to_stderr(short.trim_end()),
        }
        return Exit::Usage;
    }
    record_write(error.print().and_then(|()| io::stdout().flush()).or_else(ignore_closed_reader));
    report_result(Ok(()))
}

/// Shortens the values of the command line that the error quotes.
fn with_short_values(mut error: clap::Error) -> clap::Error {
    let short = |(kind, value): (ContextKind, &ContextValue)| match value {
        ContextValue::String(typed) => match short::shorten_value(typed) {
            short if short == *typed => None,
            short => Some((kind, ContextValue::String(short.into_owned()))),
        },
        _ => None,
    };
    let shortened: Vec<(ContextKind, ContextValue)> = error.context().filter_map(short).collect();
    for (kind, value) in shortened {
        error.insert(kind, value);
        // The suggestion repeats the value in full.
        error.remove(ContextKind::Suggested);
    }
    error
}

/// Returns the exit code. After an error it is the code of the error, which this function prints.
/// After success it is 0, or 73 if a part of the result could not be written.
pub fn report_result(result: Result<(), Failure>) -> Exit {
    match result {
        Ok(()) => with_output_errors(Exit::Ok),
        Err(failure) => {
            print_to_stderr(&failure);
            failure.exit
        }
    }
}

/// Returns `exit`, or 73 instead of success if the result could not be written.
pub fn with_output_errors(exit: Exit) -> Exit {
    if exit == Exit::Ok && IS_OUTPUT_LOST.load(Ordering::Relaxed) { Exit::Unwritten } else { exit }
}

/// Reports the first error of writing the result. [`with_output_errors`] then changes the exit code.
fn record_write(result: io::Result<()>) {
    let Err(error) = result else { return };
    if !IS_OUTPUT_LOST.swap(true, Ordering::Relaxed) {
        print_to_stderr(format_args!("cannot write the result: {error}"));
    }
}

/// Prints a line to standard error, also before the log exists. Overlong lines are shortened in the middle.
pub fn print_to_stderr(text: impl Display) {
    // If standard error cannot be written to, the error cannot be reported.
    let _ = write(&mut io::stderr().lock(), &short::shorten_lines(&text.to_string()));
}

/// Writes a line. A pipe that the reader has closed is no error.
fn write(stream: &mut impl Write, text: &dyn Display) -> io::Result<()> {
    let result = writeln!(stream, "{text}").and_then(|()| stream.flush());
    result.or_else(ignore_closed_reader)
}

/// Replaces the error about a pipe that the reader has closed by success.
fn ignore_closed_reader(error: io::Error) -> io::Result<()> {
    if error.kind() == ErrorKind::BrokenPipe { Ok(()) } else { Err(error) }
}

#[cfg(test)]
mod tests {
    use clap::{Arg, Command};

    use super::*;

    #[test]
    fn typed_value_is_quoted_in_one_short_line() {
        let refused = |text: &str| Err::<String, _>(format!("{text:?} is refused"));
        let command = Command::new("peernet").arg(Arg::new("set").long("set").value_parser(refused));
        let message = |word: &str| {
            let error = command.clone().try_get_matches_from(["peernet", word]).expect_err(word);
            short::shorten_lines(&with_short_values(error).render().to_string()).into_owned()
        };
        let text = format!("a.b=\u{1b}[31m\n{}\nthe end", "x = 1\n".repeat(10_000));
        let value = message(&format!("--set={text}"));
        let first = value.lines().next().expect("a line");
        assert!(first.starts_with("error: invalid value 'a.b= [31m x = 1"), "{value}");
        assert!(first.contains("the end' for '--set <set>': "), "{value}");
        assert!(value.len() < 1200 && value.lines().count() < 5, "{value}");
        let argument = message(&format!("--{text}"));
        assert!(argument.starts_with("error: unexpected argument '--a.b"), "{argument}");
        assert!(argument.len() < 1200 && argument.lines().count() < 9, "{argument}");
        assert!(message("--sett=1").contains("'--set'"), "the suggestion stays if the value is short");
    }

    #[test]
    fn closed_output_is_no_error() {
        let (reader, mut writer) = io::pipe().expect("a pipe");
        drop(reader);
        assert_eq!(writer.write_all(b"x").map_err(|error| error.kind()), Err(ErrorKind::BrokenPipe));
        assert!(write(&mut writer, &"a result").is_ok());
        let mut full =
            std::fs::OpenOptions::new().write(true).open("/dev/full").expect("Linux has this device");
        assert_eq!(write(&mut full, &"a result").map_err(|error| error.kind()), Err(ErrorKind::StorageFull));
    }
}
