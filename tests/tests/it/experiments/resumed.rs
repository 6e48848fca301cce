//! Tests of an interrupted experiment that is resumed.

use peernet_tests::{Process, wait_until};
use rustix::process::{Signal, kill_process};

use super::{Lab, THREE_RUNS, children, column, json, run_command};

/// Waits until the second run is in progress; returns the folders of all runs.
fn wait_for_second_run(lab: &Lab, process: &Process) -> Vec<String> {
    process.wait_for("run 2 of 3 (Size = 200): begins");
    let folders = lab.results.folders();
    lab.results.wait_for_rows(&folders[1], 3);
    folders
}

/// Checks that every run is complete and exists once.
fn assert_complete(lab: &Lab, folders: &[String]) {
    assert_eq!(lab.results.folders(), folders);
    assert_eq!(lab.results.states(), ["finished"; 3]);
    // Each run has 2 additional iterations of the warm-up.
    for (folder, (size, rows)) in folders.iter().zip([("100", 27), ("200", 252), ("300", 27)]) {
        let data = lab.results.file(folder, "data.csv");
        let numbers: Vec<String> = (1..=rows).map(|number: u32| number.to_string()).collect();
        assert_eq!(column(&data, "iteration"), numbers);
        assert!(column(&data, "upload-bytes").iter().all(|bytes| bytes == size));
    }
}

/// Checks that `compare` and `plot` show only the first run, as the experiment's own tables do, and name the other runs.
fn assert_unfinished_runs_are_left_out(lab: &Lab, folders: &[String], stage: &str) {
    let results_folder = &lab.results.folder;
    let note = format!(
        "without the runs of experiment three that are not done: {} ({stage}), {} (to do)",
        folders[1], folders[2]
    );
    let comparison = run_command("compare", results_folder);
    assert_eq!(comparison.code(), 0, "{}", comparison.log);
    for line in
        [&format!("{} is shown {note}; `peernet run ", results_folder.display()), &format!("Shown {note}.")]
    {
        assert!(comparison.log.contains(line), "{line} is not in {}", comparison.log);
    }
    assert!(!comparison.log.contains("\n200 "), "{}", comparison.log);
    let plot = run_command("plot", results_folder);
    assert_eq!(plot.code(), 0, "{}", plot.log);
    assert!(plot.log.contains(&note) && !plot.log.contains("stacked.png"), "{}", plot.log);

    let run_folder = lab.results.file(&folders[1], "");
    for command in ["compare", "plot"] {
        let end = run_command(command, &run_folder);
        let line = format!("belongs to an unfinished run, {stage}");
        assert!(end.code() == 0 && end.log.contains(&line), "{}", end.log);
    }
}

#[test]
fn interrupted_runs_are_repeated_and_finished_ones_kept() {
    let lab = Lab::new();
    let process = lab.run(THREE_RUNS, &[]);
    let folders = wait_for_second_run(&lab, &process);
    process.signal(Signal::INT);
    let end = process.wait_for_end();
    assert_eq!(end.code(), 130, "{}", end.log);
    assert!(end.log.contains("1 of 3 runs finished, 1 interrupted, 1 to do"), "{}", end.log);
    assert_eq!(lab.results.states(), ["finished", "interrupted", "pending"]);
    assert_eq!(json(&lab.results.file(&folders[1], "run.json"))["reason"], "stopped");
    assert_unfinished_runs_are_left_out(&lab, &folders, "interrupted");
    let first = json(&lab.results.file(&folders[0], "run.json"));
    let id = lab.results.record()["id"].clone();

    let changed_experiment =
        lab.run(&THREE_RUNS.replace("iterations = 25", "iterations = 26"), &[]).wait_for_end();
    assert_eq!(changed_experiment.code(), 78, "{}", changed_experiment.log);
    assert!(changed_experiment.log.contains("25 before, 26 now"), "{}", changed_experiment.log);

    let end = lab.run(THREE_RUNS, &[]).wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    assert!(!end.log.contains("run 1 of 3 (Size = 100): begins"), "{}", end.log);
    assert_complete(&lab, &folders);
    assert_eq!(json(&lab.results.file(&folders[0], "run.json")), first, "the record was not changed");
    assert_eq!(lab.results.record()["id"], id);
    assert_eq!(json(&lab.results.file(&folders[2], "run.json"))["experiment"]["id"], id);

    let repeated = lab.run(THREE_RUNS, &[]).wait_for_end();
    assert_eq!(repeated.code(), 0, "{}", repeated.log);
    assert!(repeated.log.contains("nothing to do") && !repeated.log.contains("begins"), "{}", repeated.log);
}

/// The suspended run handles no signals, so waiting for it would never end.
#[test]
fn suspended_run_is_killed_and_marked_interrupted() {
    let lab = Lab::new();
    let process = lab.run(THREE_RUNS, &[]);
    wait_for_second_run(&lab, &process);
    let [child] = children(&process).try_into().expect("one run is in progress");
    kill_process(child, Signal::STOP).expect("it runs");
    process.signal(Signal::INT);
    process.wait_for("work in progress is killed after 1 min");
    process.signal(Signal::TERM);
    process.wait_for("processes that do not end within 10 s are killed");
    let end = process.wait_for_end();
    assert_eq!(end.code(), 130, "{}", end.log);
    assert!(end.log.contains("killing the processes that did not end in time"), "{}", end.log);
    assert_eq!(lab.results.states(), ["finished", "interrupted", "pending"]);
}

#[test]
fn kill_leaves_no_process_and_no_partial_run() {
    let lab = Lab::new();
    let process = lab.run(THREE_RUNS, &[]);
    let folders = wait_for_second_run(&lab, &process);
    let [child] = children(&process).try_into().expect("one run is in progress");
    process.kill();
    wait_until("the end of the run", || {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", child.as_raw_nonzero()));
        // Only init collects the child, which may take a while. Until then the child is a zombie.
        stat.map_or(true, |stat| stat.contains(") Z ")).then_some(())
    });
    assert_eq!(lab.results.states(), ["finished", "running", "pending"]);
    assert_unfinished_runs_are_left_out(&lab, &folders, "in progress or killed");
    let end = lab.run(THREE_RUNS, &["--yes"]).wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    assert_complete(&lab, &folders);
    assert_eq!(lab.results.record()["states"][1]["attempts"], 2);
}
