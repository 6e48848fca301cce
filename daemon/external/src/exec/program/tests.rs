//! Tests with real programs, most of them a few lines of shell.

use std::num::NonZeroU64;
use std::os::unix::fs::PermissionsExt;
use std::sync::Arc;

use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
use peernet_sample::{Description, Sample};

use super::*;
use crate::exec::CommandLine;

fn clock() -> SharedClock {
    Arc::new(SystemClock::new(ClockIdentity::new("boot", "system")))
}

fn start(role: Role, script: &str, timeout_ms: u64) -> Program {
    let timeout_ms = NonZeroU64::new(timeout_ms).expect("above 0");
    let config = ExecConfig { timeout_ms, ..ExecConfig::new(CommandLine::Shell(script.to_owned())) };
    Program::start(&config, role, "the program of a test", &clock()).expect("sh is there")
}

/// Timeout that is long enough on a busy machine. Milliseconds.
const LONG_TIMEOUT_MS: u64 = 60_000;

fn payload_sample() -> Sample {
    Sample::from_part(Description::bytes(), Bytes::from_static(b"payload\nwith a line"))
}

const ECHO: &str = "while read -r word bytes media shape source; do \
    stage='stage inference 0'; echo \"$stage\"; echo \"answer $bytes $media $shape\"; head -c \"$bytes\"; done";

#[test]
fn shell_echoes_samples() {
    let mut program = start(Role::Model, ECHO, LONG_TIMEOUT_MS);
    for _ in 0..3 {
        let program_call = program.call(Request::Sample(&payload_sample())).expect("replies");
        assert_eq!(program_call.outcome, ReplyOutcome::Parts(payload_sample().parts));
        assert_eq!(program_call.notes.stages[0].0, "inference");
        assert!(program_call.ended_at > program_call.started_at);
    }
}

#[test]
fn sample_larger_than_pipe_passes_both_ways() {
    let mut program = start(Role::Model, ECHO, LONG_TIMEOUT_MS);
    let large = Sample::from_part(Description::bytes(), vec![7; 5 << 20].into());
    assert_eq!(
        program.call(Request::Sample(&large)).expect("replies").outcome,
        ReplyOutcome::Parts(large.parts)
    );
}

#[test]
fn program_receives_role_and_framing_version() {
    let script = "read -r word; echo \"source $PEERNET_ROLE $PEERNET_EXEC $word\"; echo answer 0; read -r word; echo end";
    let mut program = start(Role::Sensor, script, LONG_TIMEOUT_MS);
    let first = program.call(Request::Next).expect("replies");
    assert_eq!(first.notes.source.as_deref(), Some("sensor 1 next"));
    for _ in 0..3 {
        assert_eq!(
            program.call(Request::Next).expect("has ended").outcome,
            ReplyOutcome::End,
            "an ended sensor is not asked again"
        );
    }
}

#[test]
fn error_reply_is_returned_and_program_continues() {
    let mut program = start(
        Role::Actuator,
        "n=0; while read -r line; do n=$((n+1)); echo \"error number $n\"; done",
        LONG_TIMEOUT_MS,
    );
    let empty = Sample::from_part(Description::bytes(), Bytes::new());
    for number in 1..3 {
        let error = program.call(Request::Answer { answer: &empty, source: "x" }).expect_err("an error");
        assert_eq!(
            error.to_string(),
            format!("the program says: number {number}"),
            "the process was not restarted"
        );
    }
}

#[test]
fn error_without_text_says_what_to_write() {
    let mut program = start(Role::Sensor, "while read -r line; do echo error; done", LONG_TIMEOUT_MS);
    let error = program.call(Request::Next).expect_err("an error").to_string();
    assert_eq!(error, "the program reported an error without a text; write its reason as: error TEXT");
}

#[test]
fn end_within_answer_reports_received_bytes() {
    for (length, printed) in [(100, "abcde"), (100_000, "abcde"), (100, "")] {
        let script = format!("read -r line; echo answer {length}; printf '{printed}'; exit 0");
        let mut program = start(Role::Sensor, &script, LONG_TIMEOUT_MS);
        let error = program.call(Request::Next).expect_err("is incomplete").to_string();
        let expected = format!(
            "it announced {length} bytes, but had sent only {} bytes when the process ended with exit status 0; it is restarted",
            printed.len()
        );
        assert_eq!(error, expected);
    }
}

#[test]
fn ended_program_is_restarted() {
    let folder = tempfile::tempdir().expect("a folder");
    let marker = folder.path().join("mark");
    let script = format!(
        "read -r line; if [ -e {0} ]; then echo answer 0; read -r line; fi; touch {0}; echo so long >&2; exit 3",
        marker.display()
    );
    let mut program = start(Role::Sensor, &script, LONG_TIMEOUT_MS);
    let error = program.call(Request::Next).expect_err("the program ended").to_string();
    assert!(
        error.contains("exit status 3") && error.contains("so long") && error.contains("restarted"),
        "{error}"
    );
    assert!(program.call(Request::Next).is_ok(), "the restarted program answers");
}

/// Calls `ask` with a new program and a request for each role.
fn for_each_role<T>(script: &str, mut ask: impl FnMut(Program, Request<'_>) -> T) -> [T; 3] {
    let sample = payload_sample();
    let requests = [
        (Role::Sensor, Request::Next),
        (Role::Model, Request::Sample(&sample)),
        (Role::Actuator, Request::Answer { answer: &sample, source: "x" }),
    ];
    requests.map(|(role, request)| ask(start(role, script, LONG_TIMEOUT_MS), request))
}

/// Returns the error of the first request in each role.
fn first_errors(script: &str) -> [String; 3] {
    for_each_role(script, |mut program, request| {
        program.call(request).expect_err("the program gives no reply").to_string()
    })
}

#[test]
fn closed_output_is_reported() {
    for error in first_errors("read -r line; echo enough >&2; exec >&-; sleep 600") {
        assert!(
            error.contains(
                "closed its standard output and was killed; last lines of its standard error: enough"
            ),
            "{error}"
        );
        // PEERNet kills the program, so the signal says nothing about the program.
        assert!(!error.contains("SIG"), "{error}");
    }
    for error in first_errors("read -r line; exec >&-; cat > /dev/null; exit 3") {
        assert!(error.contains("closed its standard output and ended with exit status 3"), "{error}");
    }
    // The output ends within a line, because the program ends. The error states only the end of the program.
    for error in first_errors("read -r line; printf 'value x'; exit 3") {
        assert!(error.contains("the process ended with exit status 3"), "{error}");
    }
}

#[test]
fn shell_does_not_hide_end_of_single_program() {
    let folder = tempfile::tempdir().expect("a folder");
    let program = folder.path().join("program");
    let line = format!("{} --flag \"a word\"", program.display());
    for (script, expected_part) in [
        ("read -r line; exec >&-; sleep 600", "closed its standard output and was killed"),
        ("read -r line; kill -SEGV $$", "ended with signal 11 (SIGSEGV)"),
    ] {
        std::fs::write(&program, format!("#!/bin/sh\n{script}\n")).expect("can be written");
        std::fs::set_permissions(&program, PermissionsExt::from_mode(0o755)).expect("can be set");
        for error in first_errors(&line) {
            assert!(error.contains(expected_part), "{error}");
        }
        // The shell stays to run the second command. It reports the signal of the program as exit status 139.
        let compound_line = format!("{line}; exit $?");
        if expected_part.contains("signal") {
            for error in first_errors(&compound_line) {
                assert!(error.contains("exit status 139 (from a shell: signal 11, SIGSEGV)"), "{error}");
            }
        }
    }
}

#[test]
fn slow_program_error_contains_its_last_lines() {
    let script = "echo 'out of paper' >&2; read -r line; \
                  case $PEERNET_ROLE in actuator) echo done;; *) echo answer 0;; esac; sleep 600";
    let errors = for_each_role(script, |mut program, request| {
        program.call(request).expect("the first request is answered");
        program.timeout = Span::from_millis(100);
        program.call(request).expect_err("it sleeps").to_string()
    });
    for error in errors {
        assert!(
            error.contains("no complete reply within 100ms; last lines of its standard error: out of paper"),
            "{error}"
        );
    }
}

#[test]
fn prompt_without_line_end_counts_as_unsolicited_output() {
    let mut program =
        start(Role::Sensor, "read -r line; printf 'answer 0\\nReady> '; sleep 600", LONG_TIMEOUT_MS);
    program.call(Request::Next).expect("replies");
    let error = program.call(Request::Next).expect_err("the prompt belongs to no request").to_string();
    assert!(error.contains("it wrote \"Ready> \" without a request"), "{error}");
}

#[test]
fn control_characters_of_program_are_replaced_or_escaped() {
    let script =
        "read -r line; printf 'error \\033[31mred\\n'; read -r line; printf '\\033[31mred\\n' >&2; exit 3";
    let mut program = start(Role::Sensor, script, LONG_TIMEOUT_MS);
    for (expected_word, expected_text) in [("says", " [31mred"), ("ended", r"\u{1b}[31mred")] {
        let error = program.call(Request::Next).expect_err("an error").to_string();
        assert!(
            error.contains(expected_word) && error.contains(expected_text) && !error.contains('\x1b'),
            "{error:?}"
        );
    }
}

#[test]
fn error_quotes_output_outside_of_framing() {
    let mut program = start(Role::Model, "read -r line; echo Loading model...; cat", LONG_TIMEOUT_MS);
    let error = program.call(Request::Sample(&payload_sample())).expect_err("garbage").to_string();
    assert!(error.contains("Loading model...") && error.contains("standard error"), "{error}");
    let mut program = start(Role::Model, "head -c 100000 /dev/zero | tr '\\0' x; cat", LONG_TIMEOUT_MS);
    let error = program.call(Request::Sample(&payload_sample())).expect_err("an endless line");
    let text = error.to_string();
    // The program may write before or after the request.
    assert!(text.contains("bytes") || text.contains("without a request"), "{text}");
}

#[test]
fn extra_reply_is_reported_at_next_call() {
    // The program gives two replies to each request: `answer 1` with the byte a, and `answer 1` with the byte b.
    let mut program = start(
        Role::Sensor,
        "while read -r line; do printf 'answer 1\\naanswer 1\\nb'; done",
        LONG_TIMEOUT_MS,
    );
    assert!(program.call(Request::Next).is_ok());
    let error = program.call(Request::Next).expect_err("there was one reply too many");
    assert!(matches!(error, ProgramCallError::UnsolicitedOutput(_)), "{error}");
}

#[test]
fn huge_length_is_refused_before_allocation() {
    let mut program = start(Role::Sensor, "read -r line; echo answer 99999999999999; cat", LONG_TIMEOUT_MS);
    let error = program.call(Request::Next).expect_err("too large").to_string();
    assert!(error.contains("99999999999999") && error.contains("at most"), "{error}");
}

#[test]
fn hanging_program_is_killed_and_restarts_are_delayed() {
    let mut program = start(Role::Sensor, "sleep 600", 50);
    let error = program.call(Request::Next).expect_err("it hangs");
    assert!(matches!(error, ProgramCallError::TooSlow { .. }), "{error}");
    let mut errors = (0..6).map(|_| program.call(Request::Next).expect_err("it hangs"));
    let delay_error = errors
        .find(|error| matches!(error, ProgramCallError::RestartDelayed { .. }))
        .expect("a restart is delayed");
    assert!(delay_error.to_string().contains("no complete reply within 50ms"), "{delay_error}");
}

#[test]
fn missing_command_is_reported_at_start() {
    let config = ExecConfig::new(CommandLine::Words(vec!["/no/such/program".to_owned()]));
    let error = Program::start(&config, Role::Model, "m", &clock()).expect_err("is not there");
    assert!(error.to_string().contains("/no/such/program"), "{error}");
}
