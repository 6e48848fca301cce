//! Tests of failures before the first run, and in one of the runs.

use std::path::Path;

use peernet_tests::{Process, program, root};

use super::{Lab, THREE_RUNS, children, kill};

#[test]
fn crashed_run_is_marked_and_others_continue() {
    let lab = Lab::new();
    let process = lab.run(THREE_RUNS, &[]);
    process.wait_for("run 2 of 3 (Size = 200): begins");
    let folders = lab.results.folders();
    lab.results.wait_for_rows(&folders[1], 3);
    children(&process).into_iter().for_each(kill);
    let end = process.wait_for_end();
    assert_eq!(end.code(), 75, "{}", end.log);
    assert!(
        end.log.contains("run 2 of 3 (Size = 200): failed") && end.log.contains("signal 9"),
        "{}",
        end.log
    );
    assert!(end.log.contains("1 run failed"), "{}", end.log);
    assert_eq!(lab.results.states(), ["finished", "failed", "finished"]);
    // The table of an experiment is the same, whichever command writes it.
    let (experiment_table, copy) =
        (lab.results.folder.join("compare.txt"), lab.deployment.folder().join("compare.txt"));
    let arguments = [Path::new("compare"), &lab.results.folder, Path::new("--out"), &copy];
    let comparison = Process::start(&program("peernet"), &arguments, root(), &[]).wait_for_end();
    assert_eq!(comparison.code(), 0, "{}", comparison.log);
    let [table, copy] =
        [experiment_table, copy].map(|path| std::fs::read_to_string(path).expect("it was written"));
    assert_eq!(table, copy);
    let note = format!("without the runs of experiment three that are not done: {} (failed).", folders[1]);
    assert!(table.contains(&note), "{table}");

    let end = lab.run(THREE_RUNS, &[]).wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    assert_eq!(lab.results.states(), ["finished"; 3]);
}

#[test]
fn missing_model_and_peer_are_reported_before_first_run() {
    let lab = Lab::new();
    let file = "[experiment]\nname = 'e'\niterations = 5\npatience_s = 1\n[pipeline]\n\
                sensor = { kind = 'synthetic', size_bytes = 10 }\nplacement = { kind = 'remote', peer = '{cloud}' }\n\
                [[axis]]\nname = 'Model'\nfield = 'pipeline.placement.model'\nvalues = ['echo', 'nowhere']\n\
                [[axis]]\nname = 'Peer'\nfield = 'pipeline.placement.peer'\nvalues = ['{cloud}', 'tcp://127.0.0.1:9']\n";
    let end = lab.run(file, &[]).wait_for_end();
    assert_eq!(end.code(), 69, "{}", end.log);
    for text in ["3 of 4 configurations cannot be measured", "no model named nowhere", "connection refused"] {
        assert!(end.log.contains(text), "{text} is not in {}", end.log);
    }
    assert!(!end.log.contains("begins") && !lab.results.folder.exists(), "{}", end.log);
    for text in [
        "trying 2 of 4: Model = echo, Peer = tcp://127.0.0.1:9\n",
        "trying 4 of 4: Model = nowhere, Peer = tcp://127.0.0.1:9: skipped, tcp://127.0.0.1:9 is unreachable",
    ] {
        assert!(end.log.contains(text), "{text} is not in {}", end.log);
    }

    // A trial runs one iteration after the other, whatever the load, so one trial stands for both loads. The mistake is
    // reported for both.
    let similar_mistakes = file.split("[[axis]]").next().expect("what is before the axes").to_owned()
        + "[[axis]]\nname = 'Model'\nfield = 'pipeline.placement.model'\nvalues = ['echo', 'nowhere']\n\
           [[axis]]\nname = 'Load'\n[[axis.value]]\nlabel = 'closed'\n[[axis.value]]\nlabel = '5 Hz'\n\
           set = { 'pipeline.load' = { mode = 'rate', hz = 5.0 } }\n";
    let end = lab.run(&similar_mistakes, &[]).wait_for_end();
    assert_eq!(end.code(), 69, "{}", end.log);
    for text in [
        "trying 2 of 2: Model = nowhere, Load = closed (and 1 configuration like it)",
        "2 of 4 configurations cannot be measured",
        "\n    Model = nowhere, Load = closed\n    Model = nowhere, Load = 5 Hz",
        // After a failed trial, the table of the runs shows no durations.
        "unknown",
    ] {
        assert!(end.log.contains(text), "{text} is not in {}", end.log);
    }

    // `--only 1` selects the run with this number.
    let end = lab.run(file, &["--only", "Model=echo", "--only", "1", "--dry-run"]).wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    assert!(end.log.contains("1 of 4 runs to do") && !lab.results.folder.exists(), "{}", end.log);
}
