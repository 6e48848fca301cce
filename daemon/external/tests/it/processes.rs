//! When a process ends, the processes that it started end as well. When the program that started the process ends, all of
//! these processes end.

use std::io::{self, BufRead, BufReader, Read};
use std::process::{Command, Stdio};
use std::sync::Arc;

use peernet_clock::{ClockIdentity, SharedClock, Span, SystemClock};
use peernet_external::process::{Launch, Process, ProcessError, StderrLog};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, pidfd_open};

const MAX_LINE_BYTES: usize = 4096;
/// Timeout that is long enough on a busy machine.
const LONG_TIMEOUT: Span = Span::from_millis(60_000);

fn clock() -> SharedClock {
    Arc::new(SystemClock::new(ClockIdentity::new("boot", "test")))
}

fn shell(script: &str, clock: &SharedClock) -> Process {
    let launch = Launch {
        name: "the program of a test".to_owned(),
        stderr_log: StderrLog::Exec,
        program: "sh".into(),
        arguments: vec!["-c".into(), script.into()],
        folder: None,
        environment: [].into(),
        inherited_file: None,
    };
    Process::start(&launch, clock).expect("sh is there")
}

fn read_line(process: &mut Process, clock: &SharedClock) -> Result<String, ProcessError> {
    let line = process.read_line(MAX_LINE_BYTES, clock.mono() + LONG_TIMEOUT)?;
    Ok(String::from_utf8(line.to_vec()).expect("text"))
}

/// Child of another process. The descriptor is held so that its number is not reused.
struct WatchedChild(std::os::fd::OwnedFd);

impl WatchedChild {
    fn new(pid: &str) -> Self {
        let pid = Pid::from_raw(pid.parse().expect("a number")).expect("not 0");
        Self(pidfd_open(pid, PidfdFlags::empty()).expect("it runs"))
    }

    fn ends_in_time(&self) -> bool {
        let timeout = Timespec { tv_sec: 60, tv_nsec: 0 };
        poll(&mut [PollFd::new(&self.0, PollFlags::IN)], Some(&timeout)) == Ok(1)
    }
}

/// Script that starts a child and ends before the child ends. The script waits for a line before it ends, so that the
/// test has time to open the child's descriptor.
const SCRIPT_WITH_CHILD: &str = "sleep 600 & echo $!; read -r _; exit 3";

#[test]
fn process_that_ends_by_itself_leaves_no_processes() {
    let clock = clock();
    let mut process = shell(SCRIPT_WITH_CHILD, &clock);
    let child = WatchedChild::new(&read_line(&mut process, &clock).expect("a number"));
    process.write(&[b"go\n"], clock.mono() + LONG_TIMEOUT).expect("it reads");
    let error = read_line(&mut process, &clock).expect_err("it has ended").to_string();
    assert!(error.contains("exit status 3"), "{error}");
    assert!(child.ends_in_time());
}

#[test]
fn requested_end_leaves_no_processes() {
    let clock = clock();
    let mut process = shell(SCRIPT_WITH_CHILD, &clock);
    let child = WatchedChild::new(&read_line(&mut process, &clock).expect("a number"));
    assert!(process.end(LONG_TIMEOUT).status_text().contains("exit status 3"));
    assert!(child.ends_in_time());
}

#[test]
fn end_by_requested_signal_counts_as_requested() {
    let clock = clock();
    for (script, is_as_requested) in [
        ("echo here; exec sleep 600", true),
        // A shell reports the end by SIGTERM as exit status 143 (128 + 15).
        ("trap 'exit 143' TERM; echo here; while :; do sleep 0.01; done", true),
        ("trap 'exit 3' TERM; echo here; while :; do sleep 0.01; done", false),
        // The script sends the signal to itself before the request to end.
        ("echo here; kill -TERM $$", false),
    ] {
        let mut process = shell(script, &clock);
        read_line(&mut process, &clock).expect("it has begun");
        let end = process.end(Span::from_seconds(4));
        assert_eq!(end.ended_as_requested(), is_as_requested, "{script}: {end:?}");
    }
}

/// Starts this test program again as the host, ends the host with `end`, and asserts that the processes that the host
/// started end as well.
fn assert_children_end_with_host(end: impl FnOnce(&mut std::process::Child)) {
    let test_program = std::env::current_exe().expect("a test has a file");
    let mut host = Command::new(test_program)
        .args(["--exact", "processes::host", "--ignored", "--nocapture"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("it starts");
    let output = BufReader::new(host.stdout.take().expect("a pipe"));
    let mut watched_children = output.lines().map_while(Result::ok).filter_map(|line| {
        let (_, number) = line.split_once("child process ")?;
        Some(WatchedChild::new(number))
    });
    let children = [
        watched_children.next().expect("the child in a shell pipeline"),
        watched_children.next().expect("the child that ignores signals"),
    ];
    end(&mut host);
    host.wait().expect("it was started");
    assert!(children.iter().all(WatchedChild::ends_in_time));
}

#[test]
fn killed_host_leaves_no_processes() {
    assert_children_end_with_host(|host| host.kill().expect("it runs"));
}

#[test]
fn ended_host_leaves_no_processes() {
    assert_children_end_with_host(|host| drop(host.stdin.take()));
}

#[test]
#[ignore = "a program for the tests above, which start it"]
fn host() {
    let clock = clock();
    // The second child ignores the signals that ask a process to end.
    let script = "sleep 600 | cat & echo $!; (trap '' HUP TERM; sleep 600) & echo $!; read -r _; sleep 600";
    let mut process = shell(script, &clock);
    for _ in 0..2 {
        println!("child process {}", read_line(&mut process, &clock).expect("a number"));
    }
    io::stdin().read_to_end(&mut Vec::new()).expect("a pipe");
    // If the process were dropped, the drop would end the children. The end of the host must be enough.
    std::mem::forget(process);
}
