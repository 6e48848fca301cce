//! Tests of the shipped experiment files.

use std::path::Path;

use peernet_tests::{Process, program, root};

#[test]
fn shipped_experiments_pass_check_with_their_run_counts() {
    for (name, runs) in [
        ("demo", "10 runs of 5 configurations"),
        ("efficientnet", "6 runs of 6 configurations"),
        ("teleoperation", "9 runs of 9 configurations"),
        ("payload-study", "8 runs of 8 configurations"),
        ("sensor-study", "4 runs of 4 configurations"),
        ("llm", "4 runs of 4 configurations"),
        ("detection-line", "6 runs of 6 configurations"),
    ] {
        let file = root().join("configs/experiments").join(name).with_extension("toml");
        let arguments = [Path::new("run"), Path::new("--check"), &file];
        let end = Process::start(&program("peernet"), &arguments, root(), &[]).wait_for_end();
        assert_eq!(end.code(), 0, "{}", end.log);
        assert!(end.log.contains(runs), "{}", end.log);
    }
    let entries = std::fs::read_dir(root().join("configs/experiments")).expect("the folder exists");
    let files = entries.filter(|entry| entry.as_ref().expect("is readable").path().is_file()).count();
    assert_eq!(files, 7, "the list above does not name each file");
}

#[test]
fn unknown_key_of_device_file_is_reported_once() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("writable");
        path
    };
    let devices = write("devices.yaml", "devices:\n  cloud: 127.0.0.1\nserver: cloud\ncolour: red\n");
    let file = write(
        "e.toml",
        &format!(
            "[experiment]\nname = 'e'\niterations = 5\n[network]\nconfig = '{}'\n[pipeline]\n\
             sensor = {{ kind = 'text', length = 10 }}\nplacement = {{ kind = 'remote', peer = 'cloud' }}\n\
             [[axis]]\nname = 'Length'\nfield = 'pipeline.sensor.length'\nvalues = [1, 2, 3]\n",
            devices.display()
        ),
    );
    let arguments = [Path::new("run"), Path::new("--check"), &file];
    let end = Process::start(&program("peernet"), &arguments, root(), &[]).wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    assert_eq!(end.log.matches("ignored unknown keys: colour;").count(), 1, "{}", end.log);
}

#[test]
fn missing_or_invalid_file_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let check = |file: &Path| {
        let end =
            Process::start(&program("peernet"), &[Path::new("run"), Path::new("--check"), file], root(), &[])
                .wait_for_end();
        (end.code(), end.log)
    };
    let file = folder.path().join("e.toml");
    let (code, log) = check(&file);
    assert!(code == 66 && log.contains("e.toml"), "{code}: {log}");
    std::fs::write(&file, "[experiment]\nname = 'e'\niteration = 5\n[pipeline]\n").expect("writable");
    let (code, log) = check(&file);
    assert!(code == 78 && log.contains("e.toml: experiment.iteration: unknown field"), "{code}: {log}");

    let pictures = folder.path().join("pictures");
    std::fs::create_dir(&pictures).expect("writable");
    std::fs::write(pictures.join("labels.csv"), "file,label\n").expect("writable");
    let text = format!(
        "[experiment]\nname = 'e'\niterations = 5\n[pipeline]\nplacement = {{ kind = 'none' }}\n\
         sensor = {{ kind = 'images', path = '{}' }}\n",
        pictures.display()
    );
    // An agent would report this error on any machine, so the check reports it.
    let long_timeout = text.replace("[pipeline]", "[pipeline]\ntimeout_ms = 1000000000000");
    std::fs::write(&file, long_timeout).expect("writable");
    let (code, log) = check(&file);
    assert!(code == 78 && log.contains("e.toml: pipeline.timeout_ms: "), "{code}: {log}");
    // The trial finds this error, because it reads the files of this machine.
    std::fs::copy(root().join("models/quality-control/pictures/part-0001.jpg"), pictures.join("1.jpg"))
        .expect("writable");
    std::fs::write(&file, text).expect("writable");
    let results = folder.path().join("results");
    let arguments = [Path::new("run"), &file, Path::new("--result-loc"), &results];
    let end = Process::start(&program("peernet"), &arguments, root(), &[]).wait_for_end();
    let message = format!("\n  {}: pipeline.sensor: cannot use the labels in ", file.display());
    assert!(end.code() == 78 && end.log.contains(&message), "{}: {}", end.code(), end.log);
}

// The package and `make demo` install one program under two names.
#[test]
fn daemon_linked_as_peernet_measures_experiment() {
    let folder = tempfile::tempdir().expect("a folder");
    let link = folder.path().join("peernet");
    std::os::unix::fs::symlink(program("peernetd"), &link).expect("writable");
    let text = "[experiment]\nname = 'e'\niterations = 3\n\
                [pipeline]\nsensor = { kind = 'text', length = 10 }\nplacement = { kind = 'local', model = 'echo' }\n\
                [[model]]\nname = 'echo'\nkind = 'echo'\n";
    std::fs::write(folder.path().join("e.toml"), text).expect("writable");
    let end =
        Process::start(&link, &[Path::new("run"), Path::new("e.toml")], folder.path(), &[]).wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    assert!(end.log.contains("1 of 1 run finished"), "{}", end.log);
}
