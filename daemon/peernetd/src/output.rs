//! The one place that writes to the terminal; everything else goes through the log.

use std::fmt::Display;
use std::io::{self, ErrorKind, Write};

/// A result that the user asked for, on standard output.
///
/// When nobody reads any more, as `head` after its lines, the rest goes nowhere: the exit code still tells how it went.
pub fn say(text: impl Display) {
    if let Err(error) = write(&mut io::stdout().lock(), &text) {
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
    written.or_else(|error| if error.kind() == ErrorKind::BrokenPipe { Ok(()) } else { Err(error) })
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
