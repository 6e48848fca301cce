//! Tests that need a process of their own. Some tests load another library, and a process can load only one library.
//! One test counts the threads of its process.

use std::fs;
use std::path::Path;
use std::process::Command;

use super::{bank, loaded, quality_control, quality_control_with};

/// Runs one of the ignored tests below in a separate process and returns its output.
fn run_in_own_process(test: &str, library: Option<&Path>) -> String {
    let mut command = Command::new(std::env::current_exe().expect("is known"));
    command.args(["--ignored", "--exact", "--nocapture", &format!("process::{test}")]);
    if let Some(library) = library {
        command.env("ORT_DYLIB_PATH", library);
    }
    let output = command.output().expect("can be started");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    text
}

#[test]
#[ignore = "run by the tests below"]
fn child_checks() {
    for (_, error) in bank(&[&quality_control()]).check() {
        println!("{error}");
    }
}

#[test]
fn unusable_library_error_names_file_reason_and_remedy() {
    let folder = tempfile::tempdir().expect("can be made");
    let at = |name: &str| folder.path().join(name);
    fs::write(at("text.so"), "no library ".repeat(10)).expect("can be written");
    build(&at("other.so"), "int other;");
    build(
        &at("old.so"),
        "static const char *version(void) { return \"1.16.3\"; }\n\
         static struct { void *api; const char *(*version)(void); } base = { 0, version };\n\
         void *OrtGetApiBase(void) { return &base; }",
    );
    for (name, reason) in [
        ("text.so", "invalid ELF header"),
        ("other.so", "it is not ONNX Runtime"),
        ("old.so", "it is version 1.16.3, at least 1.17 is needed"),
        ("missing.so", "the file does not exist"),
    ] {
        let printed = run_in_own_process("child_checks", Some(&at(name)));
        for part in [name, reason, "ORT_DYLIB_PATH", "make setup"] {
            assert!(printed.contains(part), "{part}: {printed}");
        }
    }
}

fn build(library: &Path, source: &str) {
    let file = library.with_extension("c");
    fs::write(&file, source).expect("can be written");
    let status = Command::new("cc").args(["-shared", "-fPIC", "-o"]).arg(library).arg(&file).status();
    assert!(status.expect("a C compiler is installed").success());
}

#[test]
#[ignore = "run by the test below"]
fn child_counts_threads() {
    let threads = || fs::read_dir("/proc/self/task").expect("is Linux").count();
    let bank = bank(&[&quality_control_with("workers = 2\nintra_threads = 3")]);
    assert!(bank.check().is_empty()); // loads the library, which starts a thread
    let before = threads();
    let pool = loaded(&bank, "qc");
    println!("{} more threads", threads() - before);
    let maps = fs::read_to_string("/proc/self/maps").expect("is Linux");
    let mapped = maps.lines().find(|line| line.contains("peernet-model-")).expect("the weights are mapped");
    let weights = mapped.split_whitespace().last().expect("ends with the file").to_owned();
    assert!(weights.ends_with("weights.bin") && Path::new(&weights).exists(), "{mapped}");
    drop((pool, bank));
    assert!(!Path::new(&weights).exists(), "{weights} was not deleted");
    println!("{} threads remain", threads() - before);
}

/// There are two workers. Each has its own thread and two threads of ONNX Runtime, and both map the same copy of the
/// weights.
#[test]
fn configured_threads_are_used_and_weights_shared() {
    let printed = run_in_own_process("child_counts_threads", None);
    assert!(printed.contains("6 more threads") && printed.contains("0 threads remain"), "{printed}");
}
