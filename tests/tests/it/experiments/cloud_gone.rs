//! Tests of a cloud's agent that dies during an experiment.

use peernet_tests::Process;

use super::{Lab, THREE_RUNS, column, json};

/// Returns the experiment of three runs with a wait of two seconds for an absent cloud.
fn experiment_with_short_timeout() -> String {
    THREE_RUNS.replace("order =", "patience_s = 2\norder =")
}

/// Waits until the second run has some rows; returns its folder.
fn wait_for_second_run(lab: &Lab, process: &Process) -> String {
    process.wait_for("run 2 of 3 (Size = 200): begins");
    let second = lab.results.folders()[1].clone();
    lab.results.wait_for_rows(&second, 3);
    second
}

#[test]
fn missing_cloud_fails_runs_that_can_be_resumed() {
    let mut lab = Lab::new();
    let process = lab.run(&experiment_with_short_timeout(), &[]);
    let second = wait_for_second_run(&lab, &process);
    lab.kill_cloud();
    let end = process.wait_for_end();
    assert_eq!(end.code(), 75, "{}", end.log);
    assert!(end.log.contains("2 runs failed") && end.log.contains("is away"), "{}", end.log);
    assert_eq!(lab.results.states(), ["finished", "failed", "failed"]);
    // Rows that were measured before the cloud died are kept.
    let outcomes = column(&lab.results.file(&second, "data.csv"), "outcome");
    assert!(outcomes.iter().filter(|outcome| *outcome == "ok").count() >= 3, "{outcomes:?}");
    let first = json(&lab.results.file(&lab.results.folders()[0], "run.json"));

    lab.start_cloud();
    let end = lab.run(&experiment_with_short_timeout(), &[]).wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    assert_eq!(lab.results.states(), ["finished"; 3]);
    let outcomes = column(&lab.results.file(&second, "data.csv"), "outcome");
    // The second run has 250 iterations and 2 of the warm-up.
    assert_eq!((outcomes.len(), outcomes.iter().all(|outcome| outcome == "ok")), (252, true), "{outcomes:?}");
    assert_eq!(
        json(&lab.results.file(&lab.results.folders()[0], "run.json")),
        first,
        "the first run was not repeated"
    );
}

#[test]
fn returning_cloud_loses_only_iterations_in_flight() {
    let mut lab = Lab::new();
    let process = lab.run(THREE_RUNS, &[]);
    let second = wait_for_second_run(&lab, &process);
    // The cloud is suspended first, so that it certainly has an iteration in progress.
    lab.suspend_cloud();
    process.wait_for("is away");
    lab.kill_cloud();
    lab.start_cloud();
    let end = process.wait_for_end();
    assert_eq!(end.code(), 75, "failed iterations lead to exit code 75: {}", end.log);
    assert_eq!(lab.results.states(), ["finished"; 3], "{}", end.log);
    for folder in lab.results.folders() {
        let outcomes = column(&lab.results.file(&folder, "data.csv"), "outcome");
        let unanswered = outcomes.iter().filter(|outcome| *outcome != "ok").count();
        if folder == second {
            // The second run has 250 iterations and 2 of the warm-up. One iteration is in flight at a time: the first may
            // time out before the silence of the cloud ends the connection, the second is lost with the connection, and
            // a third may start before the pipeline sees this end.
            assert_eq!((outcomes.len(), (1..=3).contains(&unanswered)), (252, true), "{outcomes:?}");
        } else {
            assert_eq!((outcomes.len(), unanswered), (27, 0), "{folder}: {outcomes:?}");
        }
    }
    let repeated = lab.run(THREE_RUNS, &[]).wait_for_end();
    assert!(repeated.code() == 75 && repeated.log.contains("nothing to do"), "{}", repeated.log);
    assert!(repeated.log.contains("iterations failed in "), "{}", repeated.log);
}
