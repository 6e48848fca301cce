//! Tests of the command `peernet run` and of the record of an experiment.

use std::path::Path;

use clap::Parser;
use peernet_analysis::run_selection::{Candidate, exclusions};
use peernet_logger::HostId;
use peernet_results::ResultFolder;
use peernet_stream::ExperimentPosition;
use serde_json::{Value, json};

use super::children::ProcessResults;
use super::execute::run_result;
use super::finished_runs::load_results;
use super::state::RunResult;
use super::*;
use crate::experiment::RECORD;

#[derive(Debug, Parser)]
struct CommandLine {
    #[command(flatten)]
    arguments: Arguments,
}

const FILE: &str = "\
[experiment]
name = 'e'
order = 'declared'
iterations = 10
[pipeline]
sensor = { kind = 'text', length = 10 }
placement = { kind = 'none' }
[[axis]]
name = 'A'
field = 'pipeline.timeout_ms'
values = [1, 2]
[[axis]]
name = 'B'
field = 'pipeline.sensor.length'
values = [1, 2]
";

pub(super) fn plan(folder: &Path, text: &str) -> Plan {
    let path = folder.join("e.toml");
    std::fs::write(&path, text).expect("writable");
    let file = File::read(&path, &[]).expect("reads");
    Plan::new(&file.experiment, None, file.configurations(&[]).expect("reads").0)
}

pub(super) fn record(folder: &Path) -> Record {
    Record::new(plan(folder, FILE), "id".to_owned(), "e.toml".to_owned(), "1".to_owned())
}

fn numbers(runs: &[Run]) -> Vec<usize> {
    runs.iter().map(|run| run.number).collect()
}

fn result_with(status: RunStatus) -> RunResult {
    RunResult {
        status,
        exit: Some(if status == RunStatus::Finished { 0 } else { 69 }),
        reason: None,
        seconds: 1.5,
    }
}

#[test]
fn only_unfinished_runs_are_repeated() {
    let temporary = tempfile::tempdir().expect("a folder");
    let folder = Folder::open(&temporary.path().join("results")).expect("is new");
    let mut record = record(temporary.path());
    let runs = record.plan.runs.clone();
    for (run, status) in runs.iter().zip([RunStatus::Finished, RunStatus::Failed, RunStatus::Interrupted]) {
        record.start_run(run);
        record.end_run(run, result_with(status));
    }
    record.start_run(&runs[3]);
    folder.save(&record).expect("writable");
    // The program is killed here: the fourth run is still active.
    let mut loaded = folder::load(folder.path()).expect("reads").expect("is there");
    assert_eq!(loaded, record);
    assert_eq!(numbers(&loaded.to_do(|_| true)), [2, 3, 4]);
    loaded.start_run(&runs[1]);
    loaded.end_run(&runs[1], result_with(RunStatus::Finished));
    assert_eq!(numbers(&loaded.to_do(|_| true)), [3, 4]);
    assert_eq!((loaded.states[1].attempts, loaded.states[1].seconds), (2, Some(1.5)));
    loaded.reset_run(&runs[0]);
    assert_eq!(numbers(&loaded.to_do(|_| true)), [1, 3, 4]);
    assert_eq!(summary(&loaded), "1 of 4 runs finished, 1 interrupted, 1 in progress or killed, 1 to do");
}

#[test]
fn incomplete_results_are_measured_again() {
    let temporary = tempfile::tempdir().expect("a folder");
    let folder = Folder::open(&temporary.path().join("results")).expect("is new");
    let record = record(temporary.path());
    let run = &record.plan.runs[0];
    let message = || load_results(&folder, &record, run).err().map(|error| error.to_string());
    assert_eq!(message().as_deref(), Some("its results are missing"));
    let [path] = folder.results(&record.plan, run).try_into().expect("one user");
    std::fs::create_dir_all(&path).expect("writable");
    let data = |text: &str| std::fs::write(path.join("data.csv"), text).expect("writable");
    let whole = json!({
        "format": 1, "reason": "finished", "counts": { "ok": 2 }, "experiment": record.plan.experiment_position(run, &record.id),
    });
    let write_record = |text: &Value| {
        std::fs::write(path.join("run.json"), text.to_string()).expect("writable");
    };
    write_record(&whole);
    assert!(message().is_some_and(|why| why.contains("no data.csv")));
    data("iteration,sensing,outcome\n1,0.5,ok\n2,0.5,ok\n");
    assert_eq!(message(), None);
    let mut earlier = whole.clone();
    let position = earlier["experiment"].as_object_mut().expect("a position");
    for key in ["position", "edges"] {
        position.remove(key).expect("it is recorded");
    }
    write_record(&earlier);
    assert_eq!(message(), None, "records of earlier versions lack both keys");
    write_record(&json!({ "format": 1 }));
    assert!(message().is_some_and(|why| why.ends_with("does not say that the run was finished")));
    let another = record.plan.experiment_position(&record.plan.runs[1], &record.id);
    for (key, value, why) in [
        ("reason", json!("the peer went away"), "does not say that the run was finished"),
        ("counts", json!({}), "has no iteration counts"),
        ("experiment", json!(null), "belongs to another run"),
        ("experiment", json!(another), "belongs to another run"),
    ] {
        let mut other = whole.clone();
        other[key] = value;
        write_record(&other);
        assert!(message().is_some_and(|message| message.ends_with(why)), "{other}: {:?}", message());
    }
    write_record(&whole);
    data("iteration,sensing,outcome\n1,0.5,ok\n2,0.");
    assert!(
        message().is_some_and(|why| why.ends_with("data.csv has 1 row, but run.json counts 2 iterations"))
    );
    data("itera");
    assert!(message().is_some_and(|why| why.contains("cannot read")));
}

#[test]
fn restart_removes_only_runs_tables_and_figures() {
    let temporary = tempfile::tempdir().expect("a folder");
    let folder = Folder::open(&temporary.path().join("results")).expect("is new");
    let record = record(temporary.path());
    folder.save(&record).expect("writable");
    let [run] = folder.results(&record.plan, &record.plan.runs[0]).try_into().expect("one user");
    std::fs::create_dir_all(&run).expect("writable");
    let names =
        ["compare.txt", "users.csv", "stacked.png", "payload-latency-2.svg", "notes.txt", "photo.png"];
    for name in names {
        std::fs::write(folder.path().join(name), "").expect("writable");
    }
    clear(&folder).expect("removable");
    let is_there = |name: &str| folder.path().join(name).exists();
    assert!(!run.exists() && !is_there("experiment.json"));
    assert_eq!(names.map(is_there), [false, false, false, false, true, true]);
}

#[test]
fn inconsistent_record_is_refused_before_removal() {
    let temporary = tempfile::tempdir().expect("a folder");
    let folder = Folder::open(&temporary.path().join("results")).expect("is new");
    let whole = record(temporary.path());
    let mine = temporary.path().join("mine");
    std::fs::create_dir(&mine).expect("writable");
    for change in [
        |record: &mut Record| record.plan.runs[1].folder = "../../mine".to_owned(),
        |record: &mut Record| record.plan.runs[1].folder = ".".to_owned(),
        |record: &mut Record| record.plan.runs[1].configuration = 4,
        |record: &mut Record| record.plan.runs[1].number = 7,
        |record: &mut Record| drop(record.states.pop()),
    ] {
        let mut other = whole.clone();
        change(&mut other);
        folder.save(&other).expect("writable");
        let failure = folder::load(folder.path()).expect_err("the record is inconsistent");
        assert!(failure.exit == Exit::Data && failure.to_string().contains("--restart"), "{failure}");
        // The runs of a refused record are unknown, so no folder of a run is removed.
        clear(&folder).expect("the tables and figures are removable");
        assert!(mine.exists());
    }
}

#[test]
fn changed_file_is_refused_with_differences() {
    let folder = tempfile::tempdir().expect("a folder");
    let record = record(folder.path());
    assert!(folder::ensure_unchanged(&record, &plan(folder.path(), &format!("# a comment\n{FILE}"))).is_ok());
    let changed = FILE.replace("iterations = 10", "iterations = 11").replace("length = 10", "length = 20");
    let failure = folder::ensure_unchanged(&record, &plan(folder.path(), &changed)).expect_err("has changed");
    let text = failure.to_string();
    assert_eq!(failure.exit, Exit::Configuration);
    assert!(text.contains("limit.iterations: 10 before, 11 now") && text.contains("--restart"), "{text}");
    // The axis B overwrites the length.
    assert!(!text.contains("sensor.length"), "{text}");
}

#[test]
fn folder_belongs_to_one_experiment_and_program() {
    let temporary = tempfile::tempdir().expect("a folder");
    let path = temporary.path().join("results");
    let folder = Folder::open(&path).expect("is new");
    let second = Folder::open(&path).err().expect("the folder is locked");
    assert!(
        second.exit == Exit::Unavailable && second.to_string().contains("another peernet run uses"),
        "{second}"
    );
    drop(folder);
    // A program was killed while it wrote its first record.
    std::fs::write(path.join(".experiment-x1"), "{").expect("writable");
    let folder = Folder::open(&path).expect("the folder belongs to an experiment");
    folder.discard();
    assert!(!path.exists(), "an empty folder is removed");

    std::fs::write(temporary.path().join("notes.txt"), "mine").expect("writable");
    let foreign = Folder::open(temporary.path()).err().expect("the folder contains other files");
    assert!(
        foreign.exit == Exit::Usage && foreign.to_string().contains("not the folder of an experiment"),
        "{foreign}"
    );

    std::fs::create_dir_all(&path).expect("writable");
    std::fs::write(path.join("experiment.json"), "{").expect("writable");
    let damaged = folder::load(&path).expect_err("no JSON");
    assert!(damaged.exit == Exit::Data && damaged.to_string().contains("--restart"), "{damaged}");

    let link = temporary.path().join("link");
    std::os::unix::fs::symlink("nowhere", &link).expect("writable");
    let nowhere = Folder::open(&link).err().expect("leads nowhere");
    let message = "is a link to nowhere, which does not exist";
    assert!(nowhere.exit == Exit::Unwritten && nowhere.to_string().ends_with(message), "{nowhere}");
}

#[test]
fn check_of_file_ignores_damaged_record() {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, results) = (folder.path().join("e.toml"), folder.path().join("results"));
    std::fs::write(&file, FILE).expect("writable");
    std::fs::create_dir(&results).expect("writable");
    std::fs::write(results.join(RECORD), "{").expect("writable");
    let words = ["run".as_ref(), file.as_os_str(), "--result-loc".as_ref(), results.as_os_str()];
    let run_with = |option: &str| {
        let words = words.into_iter().chain([option.as_ref()]);
        run(&CommandLine::try_parse_from(words).expect("a command line").arguments)
    };
    run_with("--check").expect("nothing is wrong with the file");
    assert_eq!(run_with("--dry-run").expect_err("the record is damaged").exit, Exit::Data);
}

#[test]
fn folder_is_locked_before_record_is_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, results) = (folder.path().join("e.toml"), folder.path().join("results"));
    std::fs::write(&file, FILE).expect("writable");
    let words = ["run".as_ref(), file.as_os_str(), "--result-loc".as_ref(), results.as_os_str()];
    let run_with = |options: &[&str]| {
        let words = words.into_iter().chain(options.iter().map(std::ffi::OsStr::new));
        let failure = run(&CommandLine::try_parse_from(words).expect("a command line").arguments);
        failure.expect_err("the command fails").exit
    };
    assert_eq!(run_with(&["--only", "99"]), Exit::Usage);
    assert!(!results.exists(), "no empty folder remains");

    let lock = Folder::open(&results).expect("is new");
    std::fs::write(results.join(RECORD), "{").expect("writable");
    assert_eq!(run_with(&[]), Exit::Unavailable, "the damaged record is not read");
    drop(lock);
    assert_eq!(run_with(&[]), Exit::Data);
}

#[test]
fn selections_choose_runs() {
    let folder = tempfile::tempdir().expect("a folder");
    let record = record(folder.path());
    let only = |line: &str| {
        let words = ["run", "e.toml"].into_iter().chain(line.split_whitespace());
        CommandLine::try_parse_from(words).expect("a command line").arguments.only
    };
    let chosen = |line: &str| {
        let only = only(line);
        numbers(&record.to_do(|run| RunSelection::selects(&only, &record.plan, run)))
    };
    assert_eq!(chosen(""), [1, 2, 3, 4]);
    assert_eq!(chosen("--only A=1"), [1, 2]);
    assert_eq!(chosen("--only A=1 --only B=2"), [2]);
    assert_eq!(chosen("--only A=1 --only A=2 --only B=2"), [2, 4]);
    assert_eq!(chosen("--only 3 --only 4 --only B=1"), [3]);
    let unknown = |line: &str| RunSelection::describe_unknown(&only(line), &record.plan);
    assert_eq!(unknown("--only A=1 --only 4"), None);
    assert_eq!(unknown("--only B=3").as_deref(), Some("B has no value 3, only 1, 2"));
    assert_eq!(unknown("--only C=3").as_deref(), Some("there is no axis C"));
    assert_eq!(unknown("--only 5").as_deref(), Some("there is no run 5; there are 4"));
    assert!(CommandLine::try_parse_from(["run", "e.toml", "--only", "x"]).is_err());
}

#[test]
fn set_values_replace_fields_but_not_axes() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("e.toml");
    std::fs::write(&path, FILE).expect("writable");
    let read = |sets: &[&str]| {
        let words = sets.iter().flat_map(|set| ["--set", set]);
        let line =
            CommandLine::try_parse_from(["run", "e.toml"].into_iter().chain(words)).expect("a command line");
        let file = File::read(&path, &line.arguments.set)?;
        Ok(Plan::new(&file.experiment, None, file.configurations(&[])?.0))
    };
    let refused = |sets: &[&str]| -> Failure { read(sets).expect_err("refused") };
    let unchanged: Result<Plan, Failure> = read(&[]);
    let changed = read(&["experiment.iterations=20", "experiment.repeats=2"]).expect("reads");
    assert_eq!((unchanged.expect("reads").runs.len(), changed.runs.len()), (4, 8));
    let limits = changed.configurations.iter().map(|one| one.agent.pipelines[0].limit.iterations);
    assert!(limits.flatten().all(|count| count.get() == 20));
    // Each value of the axis B sets the length.
    let ineffective = refused(&["pipeline.sensor.length=7"]);
    assert_eq!(ineffective.exit, Exit::Usage);
    assert!(ineffective.to_string().contains("no effect: the axis B sets it in all runs"), "{ineffective}");
    let nowhere = refused(&["pipeline.transforms[0].width=7"]);
    assert!(nowhere.to_string().starts_with("--set: there is no pipeline.transforms[0].width"), "{nowhere}");
    let wrong = refused(&["experiment.iterations=0"]);
    assert!(
        wrong.exit == Exit::Configuration && wrong.to_string().contains("experiment.iterations"),
        "{wrong}"
    );
}

#[test]
fn title_without_axes_names_experiment_once() {
    let folder = tempfile::tempdir().expect("a folder");
    let title = |text: &str| {
        let plan = plan(folder.path(), text);
        plan.title(&plan.runs[0])
    };
    assert_eq!(title(FILE), "e: A = 1, B = 1");
    let alone = FILE.split("[[axis]]").next().expect("what is before the axes");
    assert_eq!(title(alone), "e");
    assert_eq!(title(&alone.replace("name = 'e'", "name = 'e'\nrepeats = 2")), "e: repeat 1");
}

#[test]
fn exit_code_reports_failed_and_incomplete_runs() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut record = record(folder.path());
    let runs = record.plan.runs.clone();
    for run in &runs {
        record.start_run(run);
        record.end_run(run, result_with(RunStatus::Finished));
    }
    let [not_interrupted, interrupted] = [false, true];
    assert!(result_of_runs(&record, &runs, not_interrupted).is_ok());
    record.end_run(&runs[1], RunResult { exit: Some(75), ..result_with(RunStatus::Finished) });
    let failure_of = |record: &Record, is_interrupted| {
        result_of_runs(record, &runs, is_interrupted).expect_err("the runs have problems")
    };
    assert!(failure_of(&record, not_interrupted).to_string().contains("iterations failed in 1 run"));
    record.end_run(&runs[0], result_with(RunStatus::Failed));
    let failed = failure_of(&record, not_interrupted);
    assert!(failed.exit == Exit::Incomplete && failed.to_string().contains("1 run failed"), "{failed}");
    assert_eq!(failure_of(&record, interrupted).exit, Exit::Interrupted);
    // A run without all figures has not failed. The exit code for missing figures takes precedence.
    record.end_run(&runs[0], RunResult { exit: Some(73), ..result_with(RunStatus::Finished) });
    let unwritten = failure_of(&record, not_interrupted);
    assert!(unwritten.exit == Exit::Unwritten, "{unwritten}");
    for text in ["iterations failed in 1 run", "not all figures are drawn for 1 run", "peernet plot"] {
        assert!(unwritten.to_string().contains(text), "{unwritten}");
    }
}

#[test]
fn run_without_figures_is_finished() {
    let temporary = tempfile::tempdir().expect("a folder");
    let folder = Folder::open(&temporary.path().join("results")).expect("is new");
    let record = record(temporary.path());
    let run = &record.plan.runs[0];
    let unwritten = ProcessResult {
        code: Some(73),
        reason: Some("not all figures are drawn: the disk is full".to_owned()),
    };
    let process_results = ProcessResults { results: vec![unwritten], interrupted: false };
    let status = || run_result(&folder, &record, run, &process_results, 1.0).status;
    assert_eq!(status(), RunStatus::Failed, "there are no results");
    let [path] = folder.results(&record.plan, run).try_into().expect("one user");
    let write = || write_results(&path, &record.plan.experiment_position(run, &record.id));
    write();
    std::fs::write(path.join("data.csv"), "iteration,sensing,outcome\n1,0.5,ok\n").expect("writable");
    assert_eq!(status(), RunStatus::Failed, "rows are missing");
    write();
    let result = run_result(&folder, &record, run, &process_results, 1.0);
    assert_eq!((result.status, result.exit), (RunStatus::Finished, Some(73)));
    assert!(result.reason.expect("the reason is reported").contains("not all figures are drawn"));
}

#[test]
fn run_stopped_after_its_results_is_finished() {
    let temporary = tempfile::tempdir().expect("a folder");
    let folder = Folder::open(&temporary.path().join("results")).expect("is new");
    let record = record(temporary.path());
    let run = &record.plan.runs[0];
    let killed = ProcessResult { code: None, reason: None };
    let process_results = ProcessResults { results: vec![killed], interrupted: true };
    let status = || run_result(&folder, &record, run, &process_results, 1.0).status;
    assert_eq!(status(), RunStatus::Interrupted, "there are no results");
    write_results(&folder.results(&record.plan, run)[0], &record.plan.experiment_position(run, &record.id));
    assert_eq!(status(), RunStatus::Finished);
}

#[test]
fn killed_experiment_keeps_run_with_complete_results() {
    let temporary = tempfile::tempdir().expect("a folder");
    let folder = Folder::open(&temporary.path().join("results")).expect("is new");
    let mut record = record(temporary.path());
    let run = record.plan.runs[1].clone();
    record.start_run(&run);
    folder.save(&record).expect("writable");
    let load = || folder::load(folder.path()).expect("reads").expect("is there");
    assert_eq!(numbers(&load().to_do(|_| true)), [1, 2, 3, 4], "there are no results");
    write_results(&folder.results(&record.plan, &run)[0], &record.plan.experiment_position(&run, &record.id));
    let loaded = load();
    assert_eq!(numbers(&loaded.to_do(|_| true)), [1, 3, 4]);
    assert_eq!(loaded.states[1].status, RunStatus::Finished);
    let not_interrupted = false;
    let failure =
        result_of_runs(&loaded, &[run], not_interrupted).expect_err("the program may have drawn no figures");
    assert!(failure.to_string().starts_with("not all figures are drawn for 1 run"), "{failure}");
}

#[test]
fn edge_without_run_excludes_others_as_dashboard_does() {
    let temporary = tempfile::tempdir().expect("a folder");
    let folder = Folder::open(&temporary.path().join("results")).expect("is new");
    let mut record = record(temporary.path());
    let run = record.plan.runs[0].clone();
    record.plan.configurations[run.configuration].users = 2;
    let paths = folder.results(&record.plan, &run);
    let failed = ProcessResult { code: Some(69), reason: None };
    let process_results = ProcessResults { results: vec![failed.clone(), failed], interrupted: false };
    // First only one of the two edges has results, then both have.
    for path in &paths {
        write_results(path, &record.plan.experiment_position(&run, &record.id));
        let is_finished =
            run_result(&folder, &record, &run, &process_results, 1.0).status == RunStatus::Finished;
        // The aggregator receives the same position and the same reason of the end.
        let measured = paths.iter().filter_map(|path| ResultFolder::open(path).ok());
        let exclusions = exclusions(&measured.map(|run| Candidate::from_results(&run)).collect::<Vec<_>>());
        assert!(exclusions.iter().all(|exclusion| exclusion.is_none() == is_finished), "{exclusions:?}");
        assert_eq!(is_finished, *path == paths[1]);
    }
}

/// Writes the results of a finished run of two iterations.
fn write_results(path: &Path, experiment: &ExperimentPosition) {
    std::fs::create_dir_all(path).expect("writable");
    let record_json = json!({
        "format": 1, "reason": "finished", "counts": { "ok": 2 }, "edge": { "id": HostId::random() }, "experiment": experiment,
    });
    std::fs::write(path.join("run.json"), record_json.to_string()).expect("writable");
    std::fs::write(path.join("data.csv"), "iteration,sensing,outcome\n1,0.5,ok\n2,0.5,ok\n")
        .expect("writable");
}

#[test]
fn experiment_of_another_version_is_reported() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut record = record(folder.path());
    let runs = record.plan.runs.clone();
    assert_eq!(version_change_note(&record, &runs, "2"), None, "nothing is measured yet");
    record.end_run(&runs[0], result_with(RunStatus::Finished));
    let message = version_change_note(&record, &runs[1..], "2").expect("the versions differ");
    assert!(message.starts_with("started by PEERNet 1, and continued by 2: "), "{message}");
    assert_eq!(
        (version_change_note(&record, &runs[1..], "1"), version_change_note(&record, &[], "2")),
        (None, None)
    );
}
