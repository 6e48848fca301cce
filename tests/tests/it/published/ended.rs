//! Tests of runs that end early: measured data is kept, and the exit code tells the reason.

use std::ffi::{OsStr, OsString};
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

use peernet_tests::{Process, SmallDisk, program};
use rustix::process::Signal;

use super::{Lab, picture};

/// Starts a client that measures for a long time.
fn start_endless_client(lab: &Lab, options: &str) -> Process {
    lab.start_client(&format!(
        "PEERNet --client --name jetson-orin --network-config net_config.yaml --iterations 1000000 --dataset-loc {} \
         --encoding file {options}",
        picture().display()
    ))
}

/// Returns the output of `peernet compare` for results.
fn compare_output(lab: &Lab, results: &str) -> String {
    Process::start(&program("peernet"), &["compare", results], lab.folder(), &[]).wait_for_end().log
}

fn start_server(lab: &Lab, iterations: u32) -> Process {
    lab.start_server(&format!(
        "PEERNet --server --name cluster --network-config net_config.yaml --model-name dummy --iterations {iterations}"
    ))
}

#[test]
fn ctrl_c_ends_client_with_all_results() {
    let lab = Lab::on_one_machine();
    let server = start_server(&lab, 1_000_000);
    let client = start_endless_client(&lab, "--result-loc results");
    client.wait_for("of 1,000,000");
    client.signal(Signal::INT);
    let end = client.wait_for_end();
    assert_eq!(end.code(), 130, "{}", end.log);
    assert!(end.log.contains("ended early"), "{}", end.log);
    let (data, record) = (lab.data("results"), lab.record("results"));
    assert_eq!(record["reason"], "stopped");
    let ok = data.count_outcome("ok");
    assert!(ok >= 6 && data.rows.len() - ok <= 1, "{} rows, {ok} with an answer", data.rows.len());
    assert!(lab.folder().join("results/summary.md").is_file());
    let interrupted = compare_output(&lab, "results");
    assert!(interrupted.contains("results is incomplete: the run was interrupted after "), "{interrupted}");

    server.signal(Signal::INT);
    let end = server.wait_for_end();
    assert_eq!(end.code(), 130, "{}", end.log);
    assert!(end.log.contains("answers"), "{}", end.log);
}

#[test]
fn closed_terminal_ends_client_with_all_results() {
    let lab = Lab::on_one_machine();
    let _server = start_server(&lab, 1_000_000);
    let client = start_endless_client(&lab, "--result-loc results");
    client.wait_for("of 1,000,000");
    // SIGHUP is sent when the terminal is closed.
    client.signal(Signal::HUP);
    client.wait_for("Ctrl-C again");
    let end = client.wait_for_end();
    assert_eq!(end.code(), 130, "{}", end.log);
    assert_eq!(lab.record("results")["reason"], "stopped");
}

#[test]
fn client_under_nohup_continues_after_sighup() {
    let lab = Lab::on_one_machine();
    let _server = start_server(&lab, 1_000_000);
    let peernet = program("peernet");
    let options = "--client --name jetson-orin --network-config net_config.yaml --sensor-type synthetic --iterations 60 \
                   --result-loc results";
    let arguments: Vec<&OsStr> =
        [peernet.as_os_str()].into_iter().chain(options.split(' ').map(OsStr::new)).collect();
    let client = Process::start(Path::new("nohup"), &arguments, lab.folder(), &[]);
    client.wait_for("of 60");
    client.signal(Signal::HUP);
    let end = client.wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    assert_eq!(
        (lab.data("results").count_outcome("ok"), lab.record("results")["reason"].as_str()),
        (60, Some("finished"))
    );
}

#[test]
fn folder_in_use_is_left_unchanged() {
    let lab = Lab::on_one_machine();
    let _server = start_server(&lab, 1_000_000);
    let first = start_endless_client(&lab, "--result-loc results --overwrite");
    first.wait_for("of 1,000,000");
    let second = start_endless_client(&lab, "--result-loc results --overwrite").wait_for_end();
    assert_eq!(second.code(), 69, "{}", second.log);
    assert!(second.log.contains("another peernet is writing"), "{}", second.log);
    first.signal(Signal::INT);
    let first = first.wait_for_end();
    assert_eq!(first.code(), 130, "{}", first.log);
    let record = lab.record("results");
    let warm_up = 5;
    let rows = record["counts"]["ok"].as_u64().expect("a number") + warm_up;
    assert_eq!(rows, lab.data("results").count_outcome("ok") as u64);
}

#[test]
fn results_replaced_by_killed_run_are_restored() {
    let lab = Lab::on_one_machine();
    let _server = start_server(&lab, 1_000_000);
    // Without --overwrite, a client that finds results refuses to start.
    let start_short_client = || {
        lab.start_client(&format!(
            "PEERNet --client --name jetson-orin --network-config net_config.yaml --iterations 6 --dataset-loc {} \
             --encoding file --result-loc results",
            picture().display()
        ))
    };
    let first = start_short_client().wait_for_end();
    assert_eq!(first.code(), 0, "{}", first.log);
    let killed = start_endless_client(&lab, "--result-loc results --overwrite");
    killed.wait_for("of 1,000,000");
    killed.kill();
    assert!(!lab.folder().join("results/run.json").exists(), "the previous results are not moved away");
    assert!(
        compare_output(&lab, "results").contains("the previous results are in "),
        "{}",
        compare_output(&lab, "results")
    );
    let next_run = start_short_client().wait_for_end();
    assert_eq!(next_run.code(), 64, "{}", next_run.log);
    assert!(
        next_run.log.contains("the previous results are restored; its rows are in killed.csv"),
        "{}",
        next_run.log
    );
    assert_eq!(
        (lab.data("results").rows.len(), lab.record("results")["reason"].as_str()),
        (6, Some("finished"))
    );
    let names = std::fs::read_dir(lab.folder().join("results")).expect("a folder");
    let hidden = names
        .filter(|name| name.as_ref().is_ok_and(|name| name.file_name().to_string_lossy().starts_with('.')));
    assert_eq!(hidden.count(), 0);
}

#[test]
fn results_of_killed_run_are_reported() {
    let lab = Lab::on_one_machine();
    let _server = start_server(&lab, 1_000_000);
    let killed = start_endless_client(&lab, "--result-loc results");
    killed.wait_for("of 1,000,000");
    killed.kill();
    let comparison = compare_output(&lab, "results");
    assert!(
        comparison.contains("results is incomplete: run.json is missing: the run is in progress or was"),
        "{comparison}"
    );
    assert!(comparison.contains("\nIncomplete results: results: run.json is missing"), "{comparison}");
}

#[test]
fn killed_run_leaves_no_files_after_later_runs() {
    let lab = Lab::on_one_machine();
    let _server = start_server(&lab, 1_000_000);
    let temporary = lab.folder().join("temporary");
    std::fs::create_dir(&temporary).expect("writable");
    // The name of a folder can consist of any bytes.
    let results = OsStr::from_bytes(b"res\xff");
    // Starts peernet with the arguments in `line`; the last argument is the folder of the results.
    let start = |line: &str| {
        let arguments = line.split(' ').map(OsString::from).chain([results.to_owned()]);
        let temporary = temporary.display().to_string();
        let arguments: Vec<OsString> = arguments.collect();
        Process::start(&program("peernet"), &arguments, lab.folder(), &[("TMPDIR", &temporary)])
    };
    let client = |iterations: u32| {
        start(&format!(
            "--client --name jetson-orin --network-config net_config.yaml --iterations {iterations} --dataset-loc {} \
             --encoding file --overwrite --result-loc",
            picture().display()
        ))
    };
    let names = |folder: &Path| {
        let names =
            std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("readable").file_name());
        names.map(|name| name.to_string_lossy().into_owned()).collect::<Vec<_>>()
    };
    assert_eq!(client(6).wait_for_end().code(), 0);
    let killed = client(1_000_000);
    killed.wait_for("of 1,000,000");
    killed.kill();
    assert_eq!(names(&temporary).len(), 1, "the killed client leaves its temporary folder");
    let comparison = start("compare").wait_for_end();
    assert!(comparison.log.contains("a run is in progress there or was killed"), "{}", comparison.log);

    let next_run = client(6).wait_for_end();
    assert!(next_run.code() == 0 && next_run.log.contains("killed.csv"), "{}", next_run.log);
    let remaining = names(&temporary);
    assert!(remaining.is_empty(), "{remaining:?}");
    let remaining = names(&lab.folder().join(results));
    assert!(
        remaining.iter().all(|name| !name.starts_with("killed") && !name.starts_with('.')),
        "{remaining:?}"
    );
    let comparison = start("compare").wait_for_end();
    assert!(comparison.code() == 0 && !comparison.log.contains("is incomplete"), "{}", comparison.log);
}

#[test]
fn second_signal_ends_client_without_waiting() {
    let lab = Lab::on_one_machine();
    let _server = lab.start_server(
        "PEERNet --server --name cluster --network-config net_config.yaml --model-name \"exec:sleep 600\" \
         --iterations 9",
    );
    let client = start_endless_client(&lab, "--result-loc results");
    client.wait_for("no answer from cluster");
    client.signal(Signal::INT);
    client.wait_for("Ctrl-C again");
    // A second SIGINT within half a second would count as the same signal.
    client.signal(Signal::TERM);
    client.wait_for("work in progress was abandoned");
    let end = client.wait_for_end();
    assert_eq!(end.code(), 130, "{}", end.log);
    assert!(end.log.contains("before the first measurement"), "{}", end.log);
}

#[test]
fn lost_server_leaves_rows_and_exit_code() {
    let lab = Lab::on_one_machine();
    let server = start_server(&lab, 1_000_000);
    let client = start_endless_client(&lab, "--result-loc results --patience 2");
    client.wait_for("of 1,000,000");
    server.kill();
    client.wait_for("cluster is away");
    let end = client.wait_for_end();
    assert_eq!(end.code(), 75, "{}", end.log);
    assert!(end.log.contains("gave up after 2 s"), "{}", end.log);
    let (data, record) = (lab.data("results"), lab.record("results"));
    assert_eq!((data.count_outcome("lost"), data.count_outcome("ok") + 1), (1, data.rows.len()));
    assert!(data.column("reason").last().is_some_and(|reason| !reason.is_empty()));
    assert_eq!(record["counts"]["lost"], 1);
}

#[test]
fn returning_server_is_used_again() {
    let lab = Lab::on_one_machine();
    let first = start_server(&lab, 1_000_000);
    let client = lab.start_client(&format!(
        "PEERNet --client --name jetson-orin --network-config net_config.yaml --iterations 120 --dataset-loc {} \
         --encoding file --result-loc results",
        picture().display()
    ));
    client.wait_for("of 120");
    first.kill();
    client.wait_for("cluster is away");
    let _second = start_server(&lab, 1_000_000);
    let end = client.wait_for_end();
    assert_eq!(end.code(), 75, "{}", end.log);
    assert!(end.log.contains("1 of 115 iterations failed"), "{}", end.log);
    let data = lab.data("results");
    assert_eq!((data.rows.len(), data.count_outcome("lost")), (120, 1));
}

#[test]
fn full_result_disk_loses_no_rows() {
    let disk = SmallDisk::new(1 << 20);
    let lab = Lab::on_one_machine();
    let _server = start_server(&lab, 1_000_000);
    let results = disk.folder().join("results");
    let measure = |iterations: u32, options: &str| {
        lab.start_client(&format!(
            "PEERNet --client --name jetson-orin --network-config net_config.yaml --iterations {iterations} \
             --dataset-loc {} --encoding file --result-loc {} {options}",
            picture().display(),
            results.display()
        ))
    };
    let earlier_run = measure(6, "").wait_for_end();
    assert_eq!(earlier_run.code(), 0, "{}", earlier_run.log);
    let client = measure(80, "--overwrite");
    client.wait_for("of 80");
    disk.fill();
    let end = client.wait_for_end();
    assert_eq!(end.code(), 73, "{}", end.log);
    assert!(end.log.contains("Total (sum of stages)"), "{}", end.log);
    let output = end.log.lines().find(|line| line.contains("the measurements are in"));
    let output =
        output.unwrap_or_else(|| panic!("the output does not name the folder of the results: {}", end.log));
    let (_, other_folder) =
        output.split_once("the measurements are in ").expect("the line contains this text");
    let (other_folder, note) = other_folder.split_once(" instead").expect("the line names another folder");
    assert_eq!(note, "; the previous results are restored");
    let results_path = results.display().to_string();
    assert_eq!(
        (lab.data(&results_path).rows.len(), lab.record(&results_path)["reason"].as_str()),
        (6, Some("finished"))
    );
    let rows = std::fs::read_to_string(format!("{other_folder}/data.csv")).expect("the results are there");
    assert_eq!(rows.lines().count(), 81);
    std::fs::remove_dir_all(other_folder).expect("the results belong to this test");
}

#[test]
fn full_disks_keep_rows_that_fit() {
    let (disk, temporary_disk) = (SmallDisk::new(200 << 10), SmallDisk::new(64 << 10));
    let lab = Lab::on_one_machine();
    // The model answers at once, so most rows are written together.
    let _server = lab.start_server(
        "PEERNet --server --name cluster --network-config net_config.yaml --model-name echo --iterations 1000000",
    );
    let (results, sample) = (disk.folder().join("results"), picture().display().to_string());
    let (results, temporary) = (results.display().to_string(), temporary_disk.folder().display().to_string());
    let arguments =
        "--client --name jetson-orin --network-config net_config.yaml --iterations 1500 --encoding file";
    let options = ["--generate-plots", "--dataset-loc", &sample, "--result-loc", &results];
    let arguments: Vec<&str> = arguments.split(' ').chain(options).collect();
    let client = Process::start(&program("peernet"), &arguments, lab.folder(), &[("TMPDIR", &temporary)]);
    let end = client.wait_for_end();
    assert_eq!(end.code(), 73, "{}", end.log);
    let message = "data.csv has the rows that fit; no figure is drawn";
    assert!(end.log.contains(message), "{}", end.log);
    let rows = lab.data(&results).rows;
    assert!(rows.len() > 100 && rows.len() < 1500, "{} rows", rows.len());
    let remaining = std::fs::read_dir(temporary_disk.folder()).expect("it is a folder").count();
    assert_eq!(remaining, 0, "files remain in the full temporary folder");
    assert_eq!(std::fs::read_dir(&results).expect("it is a folder").count(), 1, "data.csv alone");
}
