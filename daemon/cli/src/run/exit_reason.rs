//! Reason why a process ended.

use std::collections::VecDeque;
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;

use crate::exit::Exit;

/// Exit codes after which the last output of a process is a failure: one line, and indented lines after it. Libraries
/// may have printed other lines before the failure. [`Exit::Usage`] and [`Exit::Software`] are not listed, because the
/// command line's parser and a panic print several lines.
const FAILURE_EXITS: [Exit; 7] = [
    Exit::Data,
    Exit::NoInput,
    Exit::Unavailable,
    Exit::Unwritten,
    Exit::Incomplete,
    Exit::Configuration,
    Exit::Interrupted,
];

/// Returns the message of a process that has ended, or the signal that ended it. `error_lines` are the last lines of
/// its error output.
pub(super) fn exit_reason(status: ExitStatus, error_lines: &VecDeque<String>) -> Option<String> {
    let message = message(error_lines, status.code());
    match status.signal() {
        Some(signal) => {
            let last_output = message.map_or_else(String::new, |text| format!("; its last output: {text}"));
            Some(format!("the process was ended by signal {signal}{last_output}"))
        }
        None => message,
    }
}

/// Returns the message at the end of a process's error output, in one line. A failure is the last line that is not
/// indented, with the indented lines after it. The message of the command line's parser and of a panic has more
/// lines, so that the whole output is the message.
fn message(error_lines: &VecDeque<String>, code: Option<i32>) -> Option<String> {
    let ends_with_failure =
        code.is_some_and(|code| FAILURE_EXITS.iter().any(|exit| code == i32::from(*exit as u8)));
    let lines: Vec<&str> =
        error_lines.iter().map(|line| line.trim_end()).filter(|line| !line.is_empty()).collect();
    let first = match ends_with_failure {
        true => lines.iter().rposition(|line| !line.starts_with([' ', '\t'])).unwrap_or(0),
        false => 0,
    };
    let joined = lines.get(first..)?.iter().fold(String::new(), |text, line| {
        let separator = if text.is_empty() {
            ""
        } else if text.ends_with(':') {
            " "
        } else {
            "; "
        };
        text + separator + line.trim()
    });
    Some(joined).filter(|text| !text.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_message_of_process_is_kept() {
        let message_of = |text: &str, code| message(&text.lines().map(str::to_owned).collect(), code);
        let parser = "error: unexpected argument '--ordr' found\n\n  tip: use '--order'\n\nUsage: peernet measure\n\nFor more information, try '--help'.\n";
        assert_eq!(
            message_of(parser, Some(64)).as_deref(),
            Some(
                "error: unexpected argument '--ordr' found; tip: use '--order'; Usage: peernet measure; For more information, try '--help'."
            )
        );
        let panic =
            "thread 'main' panicked at a.rs:1:\nindex out of bounds\nnote: run with `RUST_BACKTRACE=1`";
        assert!(message_of(panic, Some(101)).is_some_and(|text| text.contains("index out of bounds")));
        assert!(message_of(panic, None).is_some_and(|text| text.contains("index out of bounds")));
        let failure = "a library: hello\ncannot load 2 models:\n  a: missing\n  b: damaged\n\n";
        assert_eq!(
            message_of(failure, Some(69)).as_deref(),
            Some("cannot load 2 models: a: missing; b: damaged")
        );
        assert_eq!(message_of("noise\nthe peer went away", Some(75)).as_deref(), Some("the peer went away"));
        assert_eq!(message_of("\n", Some(69)), None);
    }
}
