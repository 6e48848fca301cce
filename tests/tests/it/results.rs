//! Tests of results on a disk that fills up, and of `peernet compare` with results of
//! PEERNet and of the paper's program.

use std::path::Path;

use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::{Outcome, Row, Rows};
use peernet_results::{Overwrite, ResultFolder};
use peernet_tests::{LoopbackDeployment, Process, ProcessEnd, SmallDisk, program};

/// Returns a deployment with results of the paper's program: `all/small`, and `all/large`, which takes longer.
/// `upload` is the duration of an iteration's upload, seconds.
pub(crate) fn write_published_results(upload: impl Fn(u32) -> f64) -> LoopbackDeployment {
    let header = "iteration,sensing,upload,inference,download,download-bytes,download-logger-bytes,upload-bytes,\
                  upload-logger-bytes,upload-throughput,download-throughput\n";
    let deployment = LoopbackDeployment::new();
    for (name, seconds) in [("all/small", 0.005), ("all/large", 0.009)] {
        let row = |iteration: u32| {
            let (sensing, inference) = (seconds * 0.1, seconds + f64::from(iteration % 7) * 1e-5);
            let rest = "0.0004,132.0,555.0,1343220.0,301.0,613000000.0,14810000.0";
            format!("{iteration},{sensing},{},{inference},{rest}\n", upload(iteration))
        };
        let rows: String = std::iter::once(header.to_owned()).chain((1..=205).map(row)).collect();
        let folder = deployment.folder().join(name);
        std::fs::create_dir_all(&folder).expect("made");
        std::fs::write(folder.join("data.csv"), rows).expect("written");
    }
    deployment
}

fn create_deployment() -> LoopbackDeployment {
    write_published_results(|_| 0.0175)
}

fn compare(deployment: &LoopbackDeployment, arguments: &[&str]) -> ProcessEnd {
    Process::start(&program("peernet"), &[&["compare"], arguments].concat(), deployment.folder(), &[])
        .wait_for_end()
}

#[test]
fn results_of_the_published_program_are_compared() {
    let deployment = create_deployment();
    let comparison = compare(&deployment, &["all"]);
    assert_eq!(comparison.code(), 0, "{}", comparison.log);
    let lines: Vec<&str> = comparison.log.lines().collect();
    let find =
        |beginning: &str| lines.iter().find(|line| line.starts_with(beginning)).copied().unwrap_or_default();
    assert!(find("run ").contains("inference"), "{}", comparison.log);
    // An asterisk marks the best line. Five of the 205 iterations are warm-up.
    assert!(find("small").contains(" * ") && find("small").contains(" 200 "), "{}", comparison.log);
    assert!(find("Smallest mean total (stages)").contains("the other line differs"), "{}", comparison.log);
    // The mean inference of `large` takes 4 ms longer.
    assert!(
        !find("A: small. B: large.").is_empty() && find("inference ").contains("+4.0"),
        "{}",
        comparison.log
    );

    let file = compare(&deployment, &["all", "--format", "csv", "--out", "table.csv"]);
    assert_eq!((file.code(), file.log.trim()), (0, ""));
    let table = std::fs::read_to_string(deployment.folder().join("table.csv")).expect("written");
    assert!(table.starts_with("run,runs,count,unanswered,best,tie,sensing-mean,"), "{table}");
    assert!(table.contains("\nlarge,1,200,0,0,0,"), "{table}");

    // All paths to the same run are equivalent.
    let baseline =
        compare(&deployment, &["all/large/data.csv", "all", "--baseline", "./all/small", "--format", "csv"]);
    assert_eq!(baseline.code(), 0, "{}", baseline.log);
    // One line for each of the four stages, and one for their sum.
    assert_eq!(
        baseline.log.lines().filter(|line| line.starts_with("small,large,")).count(),
        5,
        "{}",
        baseline.log
    );
}

#[test]
fn comparison_errors_are_named() {
    let deployment = create_deployment();
    let missing = compare(&deployment, &["nowhere"]);
    assert_eq!(missing.code(), 66, "{}", missing.log);
    assert!(missing.log.contains("no results in nowhere: it does not exist"), "{}", missing.log);
    std::fs::write(deployment.folder().join("all/small/data.csv"), "iteration,sensing\n1,fast\n")
        .expect("written");
    let invalid = compare(&deployment, &["all"]);
    assert_eq!(invalid.code(), 65, "{}", invalid.log);
    assert!(invalid.log.contains("line 2, column sensing: \"fast\" is not a number"), "{}", invalid.log);
    assert!(invalid.log.contains("1 of 2 results cannot be read"), "{}", invalid.log);
    assert!(invalid.log.contains("total (stages)"), "the other result is not shown: {}", invalid.log);
    let unwritable = compare(&deployment, &["all/large", "--out", "nowhere/table.txt"]);
    assert_eq!(unwritable.code(), 73, "{}", unwritable.log);
}

fn row(iteration: u64) -> Row {
    Row {
        iteration,
        at: iteration as f64,
        episode: 0,
        step: 0,
        warm_up: false,
        outcome: Outcome::Ok,
        reason: None,
        values: vec![("total".into(), iteration as f64 / 1e3)],
        upload: None,
        download: None,
    }
}

/// Returns the numbers of the rows in a file, all of which must be complete.
fn numbers(path: &Path) -> Vec<u64> {
    let text = std::fs::read_to_string(path).expect("readable");
    assert!(text.ends_with('\n'), "the last row is incomplete");
    let columns = text.lines().next().map(|header| header.split(',').count());
    let rows = text.lines().skip(1);
    rows.map(|row| {
        assert_eq!(Some(row.split(',').count()), columns);
        row.split(',').next().and_then(|cell| cell.parse().ok()).expect("a number")
    })
    .collect()
}

#[test]
fn full_disk_keeps_rows_that_fit() {
    const SIZE: u64 = 200 << 10;
    let disk = SmallDisk::new(SIZE);
    let folder =
        ResultFolder::create(&disk.folder().join("results"), Overwrite::Refuse).expect("there is room");
    let mut writer = folder.create_writer().expect("there is room");
    let path = writer.path().to_owned();
    // All rows belong to one second, so they are written together.
    (1..=9000).for_each(|number| writer.write(&Row { at: 0.5, ..row(number) }));
    assert!(writer.finish().is_err(), "the disk has no room for all rows");
    let written = numbers(&path);
    assert_eq!(written, (1..=written.len() as u64).collect::<Vec<_>>());
    let bytes = std::fs::metadata(&path).expect("the file exists").len();
    assert!(bytes > SIZE / 2, "{bytes} bytes in {} rows", written.len());
}

#[test]
fn full_disk_loses_no_row() {
    let disk = SmallDisk::new(1 << 20);
    let folder =
        ResultFolder::create(&disk.folder().join("results"), Overwrite::Refuse).expect("there is room");
    let rows: Vec<Row> = (1..=3000).map(row).collect();
    let mut writer = folder.create_writer().expect("there is room");
    let path = writer.path().to_owned();
    rows[..500].iter().for_each(|row| writer.write(row));
    disk.fill();
    rows[500..1500].iter().for_each(|row| writer.write(row));
    let error = writer.write_error().expect("the disk is full").to_string();
    assert!(error.contains("No space left on device"), "{error}");
    let written = numbers(&path);
    assert!(
        (500..1500).contains(&written.len()),
        "only a part of the rows fits on the disk: {}",
        written.len()
    );

    disk.free();
    writer.write(&rows[1500]);
    assert!(writer.write_error().is_none());
    assert_eq!(numbers(&path), (1..=1501).collect::<Vec<_>>());

    disk.fill();
    rows[1501..].iter().for_each(|row| writer.write(row));
    assert!(writer.finish().is_err(), "the disk is full at the end, too");
    assert_eq!(numbers(&path)[..1501], (1..=1501).collect::<Vec<_>>());
    let rows: Rows = rows.into_iter().collect();
    let finished = folder.finish(&RunRecord::default(), &rows).expect("the temporary folder has room");
    assert!(finished.write_error.is_some() && !finished.folder.starts_with(disk.folder()));
    assert_eq!(ResultFolder::open(&finished.folder).expect("readable").rows, rows);
    std::fs::remove_dir_all(finished.folder).expect("it is ours");
}
