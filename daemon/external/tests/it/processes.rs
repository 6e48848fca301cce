//! Processes that a process started end with it, and with the program that started it.

use std::io::{self, BufRead, BufReader, Read};
use std::process::{Command, Stdio};
use std::sync::Arc;

use peernet_clock::{ClockIdentity, SharedClock, Span, SystemClock};
use peernet_external::process::{Launch, Process, ProcessError, StderrLog};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, pidfd_open};

const MOST: usize = 4096;
/// Timeout that is long enough on a busy machine.
const PATIENT: Span = Span::from_millis(60_000);

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

fn line(process: &mut Process, clock: &SharedClock) -> Result<String, ProcessError> {
    let line = process.read_line(MOST, clock.mono() + PATIENT)?;
    Ok(String::from_utf8(line.to_vec()).expect("text"))
}

/// Child of another process. The descriptor is held so that its number is not reused.
struct Watched(std::os::fd::OwnedFd);

impl Watched {
    fn new(pid: &str) -> Self {
        let pid = Pid::from_raw(pid.parse().expect("a number")).expect("not 0");
        Self(pidfd_open(pid, PidfdFlags::empty()).expect("it runs"))
    }

    fn ends(&self) -> bool {
        let patience = Timespec { tv_sec: 60, tv_nsec: 0 };
        poll(&mut [PollFd::new(&self.0, PollFlags::IN)], Some(&patience)) == Ok(1)
    }
}

/// Script that waits until the test holds the remaining process.
const LEAVES_ONE: &str = "sleep 600 & echo $!; read -r _; exit 3";

#[test]
fn process_that_ends_by_itself_leaves_nothing() {
    let clock = clock();
    let mut process = shell(LEAVES_ONE, &clock);
    let child = Watched::new(&line(&mut process, &clock).expect("a number"));
    process.write(&[b"go\n"], clock.mono() + PATIENT).expect("it reads");
    let error = line(&mut process, &clock).expect_err("it has ended").to_string();
    assert!(error.contains("exit status 3"), "{error}");
    assert!(child.ends());
}

#[test]
fn requested_end_leaves_no_processes() {
    let clock = clock();
    let mut process = shell(LEAVES_ONE, &clock);
    let child = Watched::new(&line(&mut process, &clock).expect("a number"));
    assert!(process.end(PATIENT).status_text().contains("exit status 3"));
    assert!(child.ends());
}

#[test]
fn end_by_requested_signal_is_no_fault() {
    let clock = clock();
    for (script, is_expected) in [
        ("echo here; exec sleep 600", true),
        ("trap 'exit 143' TERM; echo here; while :; do sleep 0.01; done", true),
        ("trap 'exit 3' TERM; echo here; while :; do sleep 0.01; done", false),
        // The signal arrives before the request to end.
        ("echo here; kill -TERM $$", false),
    ] {
        let mut process = shell(script, &clock);
        line(&mut process, &clock).expect("it has begun");
        let ended = process.end(Span::from_seconds(4));
        assert_eq!(ended.ended_as_requested(), is_expected, "{script}: {ended:?}");
    }
}

/// Starts this test program again as the host, so that the host can end without the test.
fn ends_with_its_host(end: impl FnOnce(&mut std::process::Child)) {
    let this = std::env::current_exe().expect("a test has a file");
    let mut host = Command::new(this)
        .args(["--exact", "processes::host", "--ignored", "--nocapture"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("it starts");
    let output = BufReader::new(host.stdout.take().expect("a pipe"));
    let mut numbers = output.lines().map_while(Result::ok).filter_map(|line| {
        let (_, number) = line.split_once("left ")?;
        Some(Watched::new(number))
    });
    let child = [numbers.next().expect("the pipeline"), numbers.next().expect("the one behind")];
    end(&mut host);
    host.wait().expect("it was started");
    assert!(child.iter().all(Watched::ends));
}

#[test]
fn killed_host_leaves_no_child_processes() {
    ends_with_its_host(|host| host.kill().expect("it runs"));
}

#[test]
fn killed_host_leaves_no_processes() {
    ends_with_its_host(|host| drop(host.stdin.take()));
}

#[test]
#[ignore = "a program for the tests above, which start it"]
fn host() {
    let clock = clock();
    // The last process ignores every signal that can be ignored.
    let script = "sleep 600 | cat & echo $!; (trap '' HUP TERM; sleep 600) & echo $!; read -r _; sleep 600";
    let mut process = shell(script, &clock);
    for _ in 0..2 {
        println!("left {}", line(&mut process, &clock).expect("a number"));
    }
    io::stdin().read_to_end(&mut Vec::new()).expect("a pipe");
    std::mem::forget(process);
}
