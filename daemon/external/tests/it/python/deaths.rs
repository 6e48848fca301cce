//! Processes that die, hang or send invalid messages: one call fails with its reason, and the next call gets another
//! process.

use std::fs;
use std::num::NonZeroU64;
use std::path::Path;
use std::process::Command;
use std::thread;
use std::time::Duration;

use peernet_external::python::{PythonObject, Role};
use peernet_sample::{Description, Part};
use rustix::fs::{CWD, FileType, Mode, mknodat};
use rustix::process::{Pid, Signal, kill_process};

use super::{Module, bytes, failure, value};

const MODEL: &str = "
import os, sys, time
class Own:
    def preprocess(self, x):
        if x == b'early':
            sys.exit('not with me')
        return x
    def infer(self, x):
        if x == b'wait':
            open('waits', 'w').close()
            time.sleep(600)
        if x == b'interrupt':
            raise KeyboardInterrupt
        if x == b'child':
            if os.fork() == 0:
                return b'of the child'
            os.wait()
        if x == b'spoil':
            for number in range(3, 20):
                try: os.write(number, b'garbage of mine')
                except OSError: pass
        if x == b'speak':
            import subprocess
            sys.stdout.buffer.write(b'\\xff\\n')
            subprocess.run(['sh', '-c', 'echo aloud; cat'])
        if x == b'unusual':
            raise type('Unusual', (BaseException,), {})('but caught')
        if x == b'half':
            raise ValueError('half \\udcff a character')
        return str(os.getpid())
";

fn process_id(model: &mut PythonObject) -> i32 {
    let answer = value(model, &[bytes(b"on")]);
    String::from_utf8(answer[0].bytes.to_vec()).expect("a number").parse().expect("a number")
}

fn kill(process_id: i32) {
    kill_process(Pid::from_raw(process_id).expect("not 0"), Signal::KILL).expect("it runs");
}

#[test]
fn killed_process_is_reported_and_restarted() {
    let module = Module::new(MODEL, "own::Own");
    let (mut model, mut other_model) = (module.model(), module.model());
    let first_id = process_id(&mut model);
    let waits = module.folder.path().join("waits");
    mknodat(CWD, &waits, FileType::Fifo, Mode::RWXU, 0).expect("a pipe");
    // The file is a named pipe, so the read waits until the call of the model opens the file.
    let killer = thread::spawn(move || {
        fs::read(waits).expect("the model opens the pipe");
        kill(first_id);
    });
    let message = failure(&mut model, &[bytes(b"wait")]);
    killer.join().expect("the process was running");
    assert!(message.contains("signal 9 (SIGKILL") && message.contains("it is restarted"), "{message}");

    // Two processes die at the same time, between calls.
    let process_ids = [process_id(&mut model), process_id(&mut other_model)];
    assert_ne!(process_ids[0], first_id);
    process_ids.into_iter().for_each(kill);
    for model in [&mut model, &mut other_model] {
        assert!(failure(model, &[bytes(b"on")]).contains("signal 9 (SIGKILL"));
        assert!(!process_ids.contains(&process_id(model)));
    }
}

#[test]
fn process_end_is_reported_and_exception_fails_call() {
    let module = Module::new(MODEL, "own::Own");
    let mut model = module.model();
    for (input, expected_parts) in [
        (&b"early"[..], ["exit status 1", "not with me"]),
        (b"interrupt", ["SIGINT", "KeyboardInterrupt"]),
        (b"spoil", ["sent an invalid message", "garbage"]),
    ] {
        let id_before = process_id(&mut model);
        let message = failure(&mut model, &[bytes(input)]);
        assert!(expected_parts.iter().all(|part| message.contains(part)), "{message}");
        assert_ne!(process_id(&mut model), id_before);
    }
    let id_before = process_id(&mut model);
    for (input, expected_part) in
        [(&b"unusual"[..], "Unusual: but caught"), (b"half", r"half \udcff a character")]
    {
        let message = failure(&mut model, &[bytes(input)]);
        assert!(message.contains(expected_part) && message.contains("in infer"), "{message}");
    }
    for input in [&b"child"[..], b"speak"] {
        assert_eq!(value(&mut model, &[bytes(input)])[0].bytes, id_before.to_string());
    }
    assert_eq!(process_id(&mut model), id_before);
}

#[test]
fn failed_start_reports_reason() {
    for (source, expected_part) in [
        ("import os\nos.kill(os.getpid(), 9)", "signal 9 (SIGKILL"),
        ("class Own:\n    def __init__(self): raise SystemExit('no camera')", "no camera"),
        ("class Own:\n    def __init__(self): raise KeyboardInterrupt", "SIGINT"),
        ("class Own:\n    def __init__(self): raise BaseException('rare')", "BaseException: rare"),
    ] {
        let message = Module::new(source, "own::Own").start_error(Role::Model);
        assert!(message.contains("cannot start own::Own") && message.contains(expected_part), "{message}");
    }
    let source = "import sys, time\nprint('looking for the arm', file=sys.stderr)\ntime.sleep(600)";
    let mut module = Module::new(source, "own::Own");
    module.config.start_timeout_ms = NonZeroU64::new(1500).expect("above 0");
    let message = module.start_error(Role::Model);
    for part in ["cannot start own::Own", "not ready within 1.5 s", "looking for the arm", "start_timeout_ms"]
    {
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn failed_restart_delays_next_restart() {
    let source = "
import os
class Own:
    def __init__(self):
        if os.path.exists('once'):
            raise RuntimeError('the camera is in use')
        open('once', 'w').close()
    def infer(self, x): os._exit(4) if x == b'exit' else None
";
    let module = Module::new(source, "own::Own");
    let mut model = module.model();
    assert!(failure(&mut model, &[bytes(b"exit")]).contains("exit status 4"));
    assert!(failure(&mut model, &[bytes(b"on")]).contains("the camera is in use"));
    let message = failure(&mut model, &[bytes(b"on")]);
    assert!(message.contains("failed repeatedly") && message.contains("the camera is in use"), "{message}");
}

#[test]
fn failed_allocation_fails_one_call() {
    let source = "
import resource
class Own:
    def __init__(self):
        used_bytes = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used_bytes + (64 << 20), resource.RLIM_INFINITY))
    def infer(self, x):
        if x == b'much': return bytearray(256 << 20)
        if x == b'answer': return [b'abcd' * (12 << 20)] * 2
        return str(len(x))
";
    let mut model = Module::new(source, "own::Own").model();
    assert!(failure(&mut model, &[bytes(b"much")]).contains("MemoryError"));
    let message = failure(&mut model, &[bytes(b"answer")]);
    assert!(message.contains("not enough memory for a value of 100663296 bytes"), "{message}");
    let large_part = Part { description: Description::bytes(), bytes: vec![7; 3 << 20].into() };
    assert_eq!(value(&mut model, &[large_part])[0].bytes, "3145728", "the same memory is used again");
    let oversized_part = Part { description: Description::bytes(), bytes: vec![7; 128 << 20].into() };
    let message = failure(&mut model, &[oversized_part, bytes(b"and a part in the pipe")]);
    assert!(!message.contains("process"), "the process did not end: {message}");
    assert_eq!(value(&mut model, &[bytes(b"four")])[0].bytes, "4");
}

#[test]
fn dead_processes_leave_no_children() {
    let test_program = std::env::current_exe().expect("a test has a file");
    let test = "python::deaths::children_after_repeated_deaths";
    let output = Command::new(test_program).args(["--exact", test, "--ignored", "--nocapture"]).output();
    let output = output.expect("it starts");
    let message =
        String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && message.contains("1 passed"), "{message}");
}

#[test]
#[ignore = "counts files and children of its process, so the test above starts it in a separate process"]
fn children_after_repeated_deaths() {
    let count = |folder: &str| fs::read_dir(folder).expect("is Linux").count();
    let module = Module::new(MODEL, "own::Own");
    let mut model = module.model();
    let die = |model: &mut PythonObject| {
        let first_id = process_id(model);
        failure(model, &[bytes(b"early")]);
        kill(process_id(model));
        failure(model, &[bytes(b"on")]);
        assert!(process_id(model) != first_id && !Path::new(&format!("/proc/{first_id}")).exists());
    };
    die(&mut model);
    let resources_before = (count("/proc/self/fd"), children());
    for _ in 0..5 {
        die(&mut model);
    }
    // On a busy machine, the thread that reads the standard error of the last process may end a moment later. The end of
    // this thread is not reported, so the test waits.
    let resources = || (count("/proc/self/fd"), children());
    for _ in 0..600 {
        if resources() != resources_before {
            thread::sleep(Duration::from_millis(100));
        }
    }
    assert_eq!(resources(), resources_before, "open files and child processes");
    drop(model);
    assert_eq!(children(), 0);
}

/// Returns the number of child processes of this process, including zombies.
fn children() -> usize {
    let threads = fs::read_dir("/proc/self/task").expect("is Linux");
    let thread_children =
        |task: fs::DirEntry| fs::read_to_string(task.path().join("children")).unwrap_or_default();
    threads.flatten().map(|task| thread_children(task).split_whitespace().count()).sum()
}
