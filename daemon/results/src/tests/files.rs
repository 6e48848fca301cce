//! Tests of files that are written and read back.

use std::path::Path;

use peernet_analysis::accuracy::Accuracy;
use peernet_analysis::compare::needs_column;
use peernet_analysis::loaded::RowsDamage;
use peernet_analysis::record::{Clocks, FORMAT, ModelRecord, to_utc};
use peernet_analysis::trust::{Report, TrustInput};
use peernet_clock::WallTime;
use peernet_logger::RunId;
use proptest::prelude::*;

use super::*;
use crate::iterations::START_NANOS;

#[test]
fn header_of_fixed_columns_is_written_before_rows() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = ResultFolder::create(folder.path(), Overwrite::Refuse).expect("it is empty");
    let path = folder.create_writer().expect("writable").finish().expect("writable");
    let text = std::fs::read_to_string(path).expect("the file exists");
    let published = peernet_analysis::rows::published_columns().collect::<Vec<_>>().join(",");
    assert_eq!(
        text,
        format!(
            "{published},upload-raw,upload-lo,upload-hi,upload-verdict,upload-source,download-raw,download-lo,\
             download-hi,download-verdict,download-source,upload-throughput-lo,upload-throughput-hi,\
             download-throughput-lo,download-throughput-hi,capture,transform,encode,send-queue,queue,ipc,actuation,\
             skipped-starts,lateness,total,stages-total,unattributed,top-1,top-5,at,episode,step,warm-up,outcome,reason\n"
        )
    );
}

fn record() -> RunRecord {
    let iterations_without_row = 3;
    RunRecord {
        format: FORMAT,
        name: "robot".to_owned(),
        title: "A robot & its cloud".to_owned(),
        run: Some(RunId::from_bytes([1; 16])),
        started: Some(to_utc(WallTime::from_unix_nanos(START_NANOS))),
        model: Some(ModelRecord { name: "s".to_owned(), device: Some("cpu".to_owned()), sha256: None }),
        pipeline: serde_json::json!({"load": {"kind": "closed"}}),
        seeds: [("order".to_owned(), 7)].into(),
        counts: Counts::from_rows(&to_rows(&rows(10)), iterations_without_row),
        clocks: Clocks::from_rows(&to_rows(&rows(10))),
        accuracy: [("top-1".to_owned(), Accuracy::from_counts(8, 9, 1).expect("answers"))].into(),
        trust: Some(Report::new(&TrustInput::default())),
        ..RunRecord::default()
    }
}

fn write(folder: &Path, rows: &[Row]) -> WrittenResults {
    let folder = ResultFolder::create(folder, Overwrite::Replace).expect("it can be created");
    let mut writer = folder.create_writer().expect("writable");
    rows.iter().for_each(|row| writer.write(row));
    writer.finish().expect("writable");
    folder.finish(&record(), &to_rows(rows)).expect("writable")
}

#[test]
fn written_rows_are_read_back() {
    let folder = tempfile::tempdir().expect("a folder");
    let finished = write(folder.path(), &rows(10));
    assert!(finished.write_error.is_none());
    let names: Vec<_> = finished.files.iter().filter_map(|file| file.file_name()?.to_str()).collect();
    assert_eq!(names, ["data.csv", "run.json", "summary.md", "summary.csv", "summary.tex"]);
    let loaded = ResultFolder::open(folder.path()).expect("readable");
    assert_eq!(loaded.rows, to_rows(&rows(10)));
    assert_eq!((loaded.record.clone(), loaded.damage()), (record(), None));
    let by_file = ResultFolder::open(&folder.path().join("data.csv")).expect("readable");
    assert_eq!((by_file.rows, by_file.record), (loaded.rows, loaded.record));
    let other_file = folder.path().join("killed.csv");
    std::fs::copy(folder.path().join("data.csv"), &other_file).expect("writable");
    let other_record = ResultFolder::open(&other_file).expect("readable").record;
    assert_eq!(
        (other_record.format, other_record.name.as_str()),
        (0, "killed"),
        "run.json describes data.csv only"
    );
}

#[test]
fn rows_are_written_during_the_run() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = ResultFolder::create(folder.path(), Overwrite::Refuse).expect("it is empty");
    let mut writer = folder.create_writer().expect("writable");
    let lines = || std::fs::read_to_string(folder.path().join("data.csv")).expect("text").lines().count();
    let mut row = rows(1).remove(0);
    writer.write(&row);
    let first = lines();
    row.at += 0.5;
    writer.write(&row);
    assert_eq!((first, lines()), (2, 2), "rows wait in memory for a second");
    row.at += 0.6;
    writer.write(&row);
    assert_eq!(lines(), 4);
    row.at -= 3600.0;
    writer.write(&row);
    assert_eq!(lines(), 5, "a clock that was set back does not stop the writing");
    writer.write(&row);
    writer.flush();
    assert_eq!(lines(), 6);
}

#[test]
fn columns_that_first_rows_lack_are_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut rows = rows(40);
    for (index, name) in [(3, "grip"), (4, "slip, left"), (30, "late")] {
        rows[index].values.push((Column::Owned(name.to_owned()), 0.5));
    }
    let result = ResultFolder::create(folder.path(), Overwrite::Refuse).expect("it is empty");
    let mut writer = result.create_writer().expect("writable");
    rows.iter().for_each(|row| writer.write(row));
    writer.flush();
    let header = |path: &Path| std::fs::read_to_string(path).expect("text").lines().next().map(str::to_owned);
    let header = header(writer.path()).expect("a header");
    // A new column rewrites the file only if the number of rows has doubled since the last rewriting. This is so for
    // `grip` and `late`, and not for `slip, left`.
    assert!(header.ends_with("reason,inference_pre,grip,late"), "{header}");
    writer.finish().expect("writable");
    result.finish(&record(), &to_rows(&rows)).expect("writable");
    assert_eq!(ResultFolder::open(folder.path()).expect("readable").rows, to_rows(&rows));
}

#[test]
fn truncated_file_gives_complete_rows() {
    let folder = tempfile::tempdir().expect("a folder");
    write(folder.path(), &rows(10));
    let path = folder.path().join("data.csv");
    let text = std::fs::read_to_string(&path).expect("text");
    std::fs::write(&path, &text[..text.len() - 3]).expect("writable");
    let loaded = ResultFolder::open(folder.path()).expect("readable");
    assert_eq!(loaded.rows, to_rows(&rows(9)));
    let damage = loaded.damage().expect("a row is missing");
    assert_eq!(damage.to_string(), "data.csv has 9 rows, but run.json counts 10 iterations");
    let text = text.replace(",lost,", ",timeout,");
    std::fs::write(&path, &text).expect("writable");
    let damage = ResultFolder::open(folder.path()).expect("readable").damage();
    assert_eq!(damage, Some(RowsDamage::Outcomes));
    std::fs::remove_file(folder.path().join("run.json")).expect("it is there");
    assert_eq!(
        ResultFolder::open(folder.path()).expect("readable").damage(),
        None,
        "there are no counts without run.json"
    );
}

#[test]
fn file_truncated_within_quoted_cell_gives_complete_rows() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut rows = rows(10);
    (rows[9].outcome, rows[9].reason) =
        (Outcome::Failed, Some("Traceback:\n  line 1\nValueError".to_owned()));
    write(folder.path(), &rows);
    let path = folder.path().join("data.csv");
    let text = std::fs::read_to_string(&path).expect("text");
    for end in ["Traceback:", "Traceback:\n", "line 1\n"] {
        let length = text.find(end).expect("in the last row") + end.len();
        std::fs::write(&path, &text[..length]).expect("writable");
        let loaded = ResultFolder::open(folder.path()).expect("readable");
        assert_eq!(loaded.rows, to_rows(&rows[..9]), "{end:?}");
    }
}

#[test]
fn comparison_reads_columns_that_incompleteness_needs() {
    let folder = tempfile::tempdir().expect("a folder");
    let incompleteness = |limit: serde_json::Value| {
        let pipeline = serde_json::json!({ "limit": limit });
        let written = RunRecord { reason: "stopped".into(), pipeline, ..record() };
        let text = serde_json::to_vec(&written).expect("JSON");
        std::fs::write(folder.path().join("run.json"), text).expect("writable");
        let whole = ResultFolder::open(folder.path()).expect("readable").incompleteness();
        let compared = ResultFolder::open_columns(folder.path(), &needs_column).expect("readable");
        assert_eq!(whole, compared.incompleteness(), "{limit}");
        whole
    };
    let mut rows = rows(10);
    rows.iter_mut().for_each(|row| row.episode = 2);
    write(folder.path(), &rows);
    let of_episodes = incompleteness(serde_json::json!({ "episodes": 3 }));
    assert_eq!(of_episodes.as_deref(), Some("the run was interrupted after 2 of 3 episodes"));
    // The clock was set back by 100 s, so that the last iteration does not have the latest start.
    rows.iter_mut().skip(5).for_each(|row| row.at -= 100.0);
    write(folder.path(), &rows);
    assert_eq!(incompleteness(serde_json::json!({ "duration_s": 600.0 })), None, "the duration is unknown");
}

#[test]
fn incomplete_results_have_reason() {
    let folder = tempfile::tempdir().expect("a folder");
    let incompleteness = |limit: u64, reason: &str| {
        let pipeline = serde_json::json!({ "limit": { "total": limit } });
        let written = RunRecord { reason: reason.into(), pipeline, ..record() };
        let text = serde_json::to_vec(&written).expect("JSON");
        std::fs::write(folder.path().join("run.json"), text).expect("writable");
        ResultFolder::open(folder.path()).expect("readable").incompleteness()
    };
    write(folder.path(), &rows(10));
    assert_eq!(incompleteness(10, "finished"), None);
    assert_eq!(
        incompleteness(10, "stopped"),
        None,
        "the run reached its limit: three of its 13 iterations have no row"
    );
    assert_eq!(incompleteness(20, "").as_deref(), None, "the reason for the end is unknown");
    let interrupted = "the run was interrupted after 13 of 20 iterations";
    assert_eq!(incompleteness(20, "stopped").as_deref(), Some(interrupted));
    let broken_off = "the run broke off after 13 of 20 iterations: the cloud went";
    assert_eq!(incompleteness(20, "the cloud went").as_deref(), Some(broken_off));

    std::fs::remove_file(folder.path().join("run.json")).expect("it is there");
    let current_incompleteness = || ResultFolder::open(folder.path()).expect("readable").incompleteness();
    assert!(
        current_incompleteness()
            .is_some_and(|incompleteness| incompleteness.contains("in progress or was killed")),
        "{:?}",
        current_incompleteness()
    );
    let separate_file = folder.path().join("run-7.csv");
    std::fs::copy(folder.path().join("data.csv"), &separate_file).expect("writable");
    assert_eq!(
        ResultFolder::open(&separate_file).expect("readable").incompleteness(),
        None,
        "only data.csv has a record"
    );
    std::fs::write(folder.path().join("data.csv"), "iteration,inference\n1,0.1\n").expect("writable");
    assert_eq!(current_incompleteness(), None, "a file of the paper's program has no record");
}

#[test]
fn empty_record_counts_as_missing() {
    let folder = tempfile::tempdir().expect("a folder");
    write(folder.path(), &rows(10));
    std::fs::write(folder.path().join("run.json"), "").expect("writable");
    let loaded = ResultFolder::open(folder.path()).expect("the rows are complete");
    assert_eq!(loaded.rows, to_rows(&rows(10)));
    let incompleteness = loaded.incompleteness().expect("the record is missing");
    assert!(incompleteness.contains("run.json is missing"), "{incompleteness}");
}

#[test]
fn unwritable_folder_loses_no_rows() {
    let folder = tempfile::tempdir().expect("a folder");
    let result = ResultFolder::create(folder.path(), Overwrite::Refuse).expect("it is empty");
    // Every write to this file fails like on a full disk, also for root.
    std::os::unix::fs::symlink("/dev/full", folder.path().join("run.json")).expect("a link");
    let mut writer = result.create_writer().expect("writable");
    rows(10).iter().for_each(|row| writer.write(row));
    writer.finish().expect("writable");
    let finished = result.finish(&record(), &to_rows(&rows(10))).expect("the temporary folder is writable");
    let write_error = finished.write_error.expect("the folder cannot be written").to_string();
    assert!(write_error.contains("run.json") && write_error.contains("No space left"), "{write_error}");
    assert_ne!(finished.folder, folder.path());
    assert_eq!(ResultFolder::open(&finished.folder).expect("readable").rows, to_rows(&rows(10)));
    std::fs::remove_dir_all(finished.folder).expect("it can be removed");
}

#[test]
fn full_disk_is_reported_at_start() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = ResultFolder::create(folder.path(), Overwrite::Refuse).expect("it is empty");
    std::os::unix::fs::symlink("/dev/full", folder.path().join("data.csv")).expect("a link");
    let error = folder.create_writer().expect_err("the disk is full").to_string();
    assert!(error.contains("No space left on device"), "{error}");
}

#[test]
fn existing_results_are_replaced_only_with_overwrite() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    for name in ["data.csv", "sensor.txt", "sensing-time.png", "series.svg", "stacked.svg", "notes.txt"] {
        std::fs::write(at.join(name), "x").expect("writable");
    }
    let refused = ResultFolder::create(at, Overwrite::Refuse).expect_err("it is not empty").to_string();
    assert!(refused.contains("is not empty") && refused.contains("--overwrite"), "{refused}");
    let subfolders = [2, 3].map(|_| {
        ResultFolder::create(at, Overwrite::Subfolder).expect("it can be created").path().to_owned()
    });
    assert_eq!(subfolders, [at.join("run-2"), at.join("run-3")]);
    ResultFolder::create(at, Overwrite::Replace).expect("results may be replaced");
    let remaining =
        ["data.csv", "sensor.txt", "sensing-time.png", "series.svg", "stacked.svg", "notes.txt", "run-2"]
            .map(|name| at.join(name).exists());
    assert_eq!(remaining, [false, false, false, false, false, true, true]);
    let file =
        ResultFolder::create(&at.join("notes.txt"), Overwrite::Replace).expect_err("a file").to_string();
    assert!(file.ends_with("notes.txt is not a folder"), "{file}");
}

#[test]
fn folder_is_locked_for_one_program() {
    let folder = tempfile::tempdir().expect("a folder");
    let first = ResultFolder::create(folder.path(), Overwrite::Replace).expect("it is not locked");
    for overwrite in [Overwrite::Replace, Overwrite::Refuse] {
        let refused = ResultFolder::create(folder.path(), overwrite).expect_err("it is locked").to_string();
        assert!(refused.contains("another peernet is writing"), "{refused}");
    }
    let subfolder = ResultFolder::create(folder.path(), Overwrite::Subfolder).expect("it can be created");
    assert_eq!(subfolder.path(), folder.path().join("run-2"));
    assert_eq!(
        std::fs::read_dir(first.path()).expect("a folder").count(),
        1,
        "only the subfolder is in it: a lock needs no file"
    );
    drop(first);
    ResultFolder::create(folder.path(), Overwrite::Replace).expect("it is not locked any more");
}

#[test]
fn folders_are_found_in_natural_order() {
    let folder = tempfile::tempdir().expect("a folder");
    for name in ["b/run-10", "b/run-2", "a", "empty", ".hidden"] {
        std::fs::create_dir_all(folder.path().join(name)).expect("made");
    }
    for name in ["b/run-10", "b/run-2", "a", ".hidden"] {
        std::fs::write(folder.path().join(name).join("data.csv"), "").expect("writable");
    }
    let found = ResultFolder::find(folder.path());
    let expected = ["a", "b/run-2", "b/run-10"].map(|name| folder.path().join(name));
    assert_eq!(found, expected);
    assert_eq!(ResultFolder::find(&expected[0]), expected[..1]);
}

#[test]
fn invalid_file_error_names_line_and_column() {
    let folder = tempfile::tempdir().expect("a folder");
    let open = |text: &str| {
        std::fs::write(folder.path().join("data.csv"), text).expect("writable");
        ResultFolder::open(folder.path()).expect_err("invalid rows").to_string()
    };
    assert!(
        open("iteration,sensing\n1,0.5\n2,fast\n")
            .ends_with("line 3, column sensing: \"fast\" is not a number")
    );
    assert!(open("x,y\n1,2\n").contains("it has no column of a run"));
    assert!(open("iteration,sensing\n1,0.5,7\n").contains("data.csv"));
    std::fs::remove_file(folder.path().join("data.csv")).expect("it is there");
    let error = ResultFolder::open(folder.path()).expect_err("no rows").to_string();
    assert!(error.contains("it has no data.csv"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn any_number_and_any_text_are_read_back(
        numbers in prop::collection::vec(prop::num::f64::NORMAL | prop::num::f64::ZERO | prop::num::f64::SUBNORMAL, 1..8),
        reason in "[^\r]{1,20}x", name in "[a-z ,\"]{0,8}x", at in 1.0..4e9_f64,
    ) {
        let folder = tempfile::tempdir().expect("a folder");
        let rows: Vec<Row> = numbers.iter().zip(1..).map(|(number, iteration)| Row {
            iteration, at, episode: 1, step: 2, warm_up: false, outcome: Outcome::Failed,
            reason: Some(reason.clone()),
            values: vec![("sensing".into(), *number), (Column::Owned(name.trim().to_owned()), -number)],
            upload: None, download: None,
        }).collect();
        write(folder.path(), &rows);
        prop_assert_eq!(ResultFolder::open(folder.path()).expect("readable").rows, to_rows(&rows));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn file_is_same_whichever_row_introduces_column(
        count in 1..60_usize,
        cells in prop::collection::vec((0..60_usize, "[a-e]", 0.0..1.0_f64), 0..12),
    ) {
        let mut rows = rows(count as u64);
        for (index, name, value) in cells {
            rows[index % count].values.push((Column::Owned(name), value));
        }
        let folders = [(); 2].map(|()| tempfile::tempdir().expect("a folder"));
        write(folders[0].path(), &rows);
        let without_writer = ResultFolder::create(folders[1].path(), Overwrite::Refuse).expect("it is empty");
        without_writer.finish(&record(), &to_rows(&rows)).expect("writable");
        let [written, expected] =
            folders.map(|folder| std::fs::read_to_string(folder.path().join("data.csv")).expect("text"));
        prop_assert_eq!(written, expected);
    }
}
