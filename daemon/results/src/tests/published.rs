//! Tests with files of the paper's program.

use super::*;

/// File as pandas writes it, with the stages `preprocessing` and `postprocessing` and without a column for warm-up.
const SAMPLE: &str = "\
iteration,sensing,upload,preprocessing,inference,postprocessing,download,download-bytes,download-logger-bytes,upload-bytes,upload-logger-bytes,upload-throughput,download-throughput
1,0.000912,0.018211,0.010112,0.080204,0.010095,0.000377,132.0,555.0,1343220.0,301.0,590200000.0,14600000.0
2,0.000705,0.017533,0.010101,0.080190,0.010088,0.000371,132.0,555.0,1343220.0,301.0,613000000.0,14810000.0
3,0.000705,0.017533,0.010101,0.080190,0.010088,-0.002014,132.0,555.0,1343220.0,301.0,613000000.0,
4,0.000701,0.017501,0.010100,0.080188,0.010086,0.000370,132.0,555.0,1343220.0,301.0,614000000.0,14850000.0
5,0.000701,0.017501,0.010100,0.080188,0.010086,0.000370,132.0,555.0,1343220.0,301.0,614000000.0,14850000.0
6,0.000700,0.017500,0.010000,0.080000,0.010000,0.000300,132.0,555.0,1343220.0,301.0,614000000.0,nan
7,0.000800,0.017600,0.010000,0.080000,0.010000,0.000300,132.0,555.0,1343220.0,301.0,614000000.0,14850000.0
";

#[test]
fn published_file_without_record_is_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let results = folder.path().join("jetson");
    std::fs::create_dir(&results).expect("made");
    std::fs::write(results.join("data.csv"), SAMPLE).expect("writable");
    let loaded = ResultFolder::open(&results).expect("readable");
    let warm_up: Vec<bool> = loaded.rows.iter().map(|row| row.warm_up()).collect();
    assert_eq!(
        warm_up,
        [true, true, true, true, true, false, false],
        "the figures of the paper's program drop the first five"
    );
    let last = loaded.rows.get(6).expect("seven");
    assert_eq!(
        (last.iteration(), last.outcome(), last.value("total"), last.value("at")),
        (7, Outcome::Ok, None, None)
    );
    let sum = last.value("stages-total").expect("the paper's Total");
    assert!((sum - 0.1187).abs() < 1e-12, "{sum}");
    assert_eq!(loaded.rows.get(5).and_then(|row| row.value("download-throughput")), None);
    assert_eq!((last.upload(), last.download()), (None, None), "the file has no bounds of delays");
    assert_eq!((loaded.record.name.as_str(), loaded.record.format), ("jetson", 0));
    assert_eq!(loaded.record.counts, Counts { ok: 2, warm_up: 5, ..Counts::default() });
    let summary = Summary::from_rows(&loaded.rows);
    assert_eq!(summary.quantity("sensing").map(|sensing| (sensing.count, sensing.max)), Some((2, 0.0008)));
}

#[test]
fn stage_with_nested_nodes_keeps_its_own_duration() {
    let folder = tempfile::tempdir().expect("a folder");
    let text = "iteration,sensing,upload,inference_val,inference_backbone,inference_head,download\n\
                1,0.001,0.02,0.09,0.06,0.025,0.0005\n";
    std::fs::write(folder.path().join("data.csv"), text).expect("writable");
    let loaded = ResultFolder::open(folder.path()).expect("readable");
    let row = loaded.rows.get(0).expect("one");
    let nested = row.value("inference_backbone");
    assert_eq!((row.value("inference"), nested), (Some(0.09), Some(0.06)));
    let sum = row.value("stages-total").expect("the paper's Total");
    assert!((sum - 0.1115).abs() < 1e-12, "the nested nodes are parts of the inference: {sum}");
}

#[test]
fn export_of_dashboard_is_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run-7.csv");
    let text = "iteration,episode,step,warm-up,outcome,reason,started,total,sensing,upload,upload-lo,upload-hi\n\
                1,1,1,true,ok,,2026-11-20T22:41:07.123456789Z,0.5,0.1,0.2,0.19,0.21\n\
                2,1,2,false,ok,,2026-11-20T22:41:08.123456789Z,0.4,0.1,0.2,0.19,0.21\n";
    std::fs::write(&path, text).expect("writable");
    let loaded = ResultFolder::open(&path).expect("readable");
    let rows: Vec<_> = loaded.rows.iter().map(|row| (row.warm_up(), row.value("total"))).collect();
    assert_eq!(rows, [(true, Some(0.5)), (false, Some(0.4))]);
    std::fs::write(&path, text.replace("true", "maybe")).expect("writable");
    let error = ResultFolder::open(&path).expect_err("neither true nor false").to_string();
    assert!(error.contains("line 2, column warm-up: \"maybe\" is not a number"), "{error}");
}

#[test]
fn infinite_number_is_unknown_except_upper_bound() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("data.csv");
    let text = "sensing,upload,upload-bytes,grip,upload-throughput-lo,upload-throughput-hi\n\
                inf,1.5,inf,-inf,-inf,inf\n0.5,1.5,1e308,nan,2,-inf\n";
    std::fs::write(&path, text).expect("writable");
    let rows = ResultFolder::open(&path).expect("readable").rows;
    let cells = |column: &str| rows.iter().map(|row| row.value(column)).collect::<Vec<_>>();
    assert_eq!(cells("sensing"), [None, Some(0.5)]);
    assert_eq!(cells("upload-bytes"), [None, Some(1e308)]);
    assert_eq!(cells("grip"), [None, None]);
    assert_eq!(cells("upload-throughput-lo"), [None, Some(2.0)]);
    assert_eq!(cells("upload-throughput-hi"), [Some(f64::INFINITY), None]);
    assert_eq!(cells("stages-total"), [None, Some(2.0)], "the sum is unknown if a stage is infinite");
}

#[test]
fn known_fields_of_other_versions_record_are_read() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("data.csv"), "iteration,inference\n1,0.5\n").expect("writable");
    std::fs::write(
        folder.path().join("run.json"),
        r#"{"format": 9, "title": "x", "edge": {"name": "e"}, "moon": 1}"#,
    )
    .expect("writable");
    let loaded = ResultFolder::open(folder.path()).expect("readable");
    assert_eq!((loaded.record.title.as_str(), loaded.record.edge.name.as_str()), ("x", "e"));
    assert!(
        loaded.rows.get(0).is_some_and(|row| !row.warm_up()),
        "a program that writes run.json flags warm-up rows, and this row has no flag"
    );
    std::fs::write(folder.path().join("run.json"), "{").expect("writable");
    let error = ResultFolder::open(folder.path()).expect_err("invalid JSON").to_string();
    assert!(error.contains("run.json: EOF"), "{error}");
}
