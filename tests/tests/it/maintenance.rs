//! Tests of an operator's work with the database: backups, health checks, rebuilt roll-ups.

use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use peernet_tests::truth::query_database;
use peernet_tests::{AGGREGATOR, Api, LoopbackDeployment, Process, ProcessEnd, free_port, wait_until};
use serde_json::Value;

const EDGE: &str = r#"
[[model]]
name = "echo"
kind = "echo"

[[pipeline]]
name = "loop"
sensor = { kind = "synthetic", size_bytes = 1000 }
placement = { kind = "local", model = "echo" }
load = { mode = "rate", hz = 200.0 }
"#;

/// Starts aggregator and agent of a deployment; returns when more than 300 iterations have succeeded.
fn start_measuring() -> (LoopbackDeployment, Process, Process, Api) {
    let deployment = LoopbackDeployment::new();
    let (aggregator, api) = deployment.start_aggregator();
    let edge = deployment.start_agent("edge", EDGE);
    wait_until("stored iterations", || (successful_iterations(&api) > 300).then_some(()));
    (deployment, aggregator, edge, api)
}

/// Returns the number of successful iterations of the newest run.
fn successful_iterations(api: &Api) -> u64 {
    api.json("/api/v1/runs")["runs"][0]["counts"]["ok"].as_u64().unwrap_or_default()
}

fn run(deployment: &LoopbackDeployment, arguments: &[&str]) -> ProcessEnd {
    deployment.peernetd(arguments).wait_for_end()
}

fn query_number(database: &Path, sql: &str) -> u64 {
    let text = query_database(database, sql);
    text.trim().parse().unwrap_or_else(|_| panic!("{sql}: {text}"))
}

fn database_path(deployment: &LoopbackDeployment) -> PathBuf {
    deployment.folder().join("aggregator.sqlite")
}

/// Returns the statistics of whole runs in a form that can be compared: means with ten significant digits, and sums of
/// squared deviations with seven.
fn statistics(database: &Path) -> String {
    query_database(
        database,
        "SELECT run, name, quantity, count, printf('%.9e', mean), printf('%.6e', m2), min, max, hex(sketch) \
         FROM rollup WHERE resolution_s = 0 ORDER BY 1, 2, 3",
    )
}

/// Changes a database that no process uses.
fn change_database(database: &Path, sql: &str) {
    let result = Command::new("sqlite3").arg(database).arg(sql).status();
    assert!(result.is_ok_and(|status| status.success()), "{sql}");
}

/// Overwrites the beginning of a table's first page.
fn damage_table(file: &Path, table: &str) {
    let page = query_number(file, &format!("SELECT rootpage FROM sqlite_schema WHERE name = '{table}'"));
    let size = query_number(file, "SELECT page_size FROM pragma_page_size");
    let file = std::fs::File::options().write(true).open(file).expect("the database exists");
    file.write_all_at(&[0xa5; 16], (page - 1) * size).expect("it can be written");
}

#[test]
fn backup_of_busy_aggregator_is_consistent() {
    let (deployment, aggregator, edge, api) = start_measuring();
    let before = successful_iterations(&api);
    let end = run(&deployment, &["backup", "--config", "aggregator.toml", "copy.sqlite"]);
    assert_eq!(end.code(), 0, "{}", end.log);
    assert!(end.log.contains("copy.sqlite"), "the output does not name the copy: {}", end.log);
    let after =
        wait_until("more iterations", || Some(successful_iterations(&api)).filter(|now| *now > before + 100));

    // The counts in one table equal the rows of the others, so all tables are copied as they were at one time.
    let copy = deployment.folder().join("copy.sqlite");
    let iterations = query_number(&copy, "SELECT ok + failed + lost + timeout + warm_up FROM run");
    assert_eq!(query_number(&copy, "SELECT count(*) FROM iteration"), iterations);
    assert_eq!(query_number(&copy, "SELECT max(number) FROM iteration"), iterations);
    assert_eq!(
        query_number(&copy, "SELECT count(*) FROM node"),
        query_number(&copy, "SELECT sum(nodes) FROM host")
    );
    let ok = query_number(&copy, "SELECT ok FROM run");
    assert!((before..after).contains(&ok), "{before} ≤ {ok} < {after}");
    assert!(!deployment.folder().join("copy.sqlite.partial").exists());
    let end = run(&deployment, &["doctor", "--full", "--database", "copy.sqlite"]);
    assert_eq!(end.code(), 0, "{}", end.log);
    assert!(end.log.contains("healthy"), "{}", end.log);

    let second_backup = run(&deployment, &["backup", "--config", "aggregator.toml", "copy.sqlite"]);
    assert_eq!(second_backup.code(), 69, "{}", second_backup.log);
    assert!(second_backup.log.contains("already exists"), "{}", second_backup.log);
    let missing_database = run(&deployment, &["backup", "--database", "none.sqlite", "other.sqlite"]);
    assert_eq!(missing_database.code(), 69, "{}", missing_database.log);
    assert!(
        !deployment.folder().join("none.sqlite").exists()
            && !deployment.folder().join("other.sqlite").exists()
    );
    assert_eq!(edge.stop().code(), 0);
    assert_eq!(aggregator.stop().code(), 0);
}

#[test]
fn aggregator_continues_from_backup_and_reports_gap() {
    let (deployment, aggregator, edge, api) = start_measuring();
    let end = run(&deployment, &["backup", "--config", "aggregator.toml", "copy.sqlite"]);
    assert_eq!(end.code(), 0, "{}", end.log);
    let before = successful_iterations(&api);
    wait_until("more iterations", || (successful_iterations(&api) > before + 300).then_some(()));
    aggregator.kill();
    for file in ["aggregator.sqlite", "aggregator.sqlite-wal", "aggregator.sqlite-shm"] {
        // A write-ahead log and its index do not always exist.
        let _result = std::fs::remove_file(deployment.folder().join(file));
    }
    std::fs::rename(deployment.folder().join("copy.sqlite"), database_path(&deployment))
        .expect("the copy exists");

    // The agent has deleted the events that were acknowledged after the copy was made. They are reported as a gap.
    let (aggregator, api) = deployment.start_aggregator();
    api.wait_until("/api/v1/hosts/edge", |host| {
        host["stored"]["gaps"].as_u64().is_some_and(|gaps| gaps > 0).then_some(())
    });
    let now = successful_iterations(&api);
    wait_until("new iterations", || (successful_iterations(&api) > now + 100).then_some(()));
    assert_eq!(edge.stop().code(), 0);
    assert_eq!(aggregator.stop().code(), 0);
    let end = run(&deployment, &["doctor", "--config", "aggregator.toml"]);
    assert_eq!(end.code(), 0, "a reported gap is not damage: {}", end.log);
    assert!(end.log.contains("never arrived"), "{}", end.log);
}

#[test]
fn doctor_exit_code_reports_damage() {
    let (deployment, aggregator, edge, _api) = start_measuring();
    // Both processes are running.
    let end = run(&deployment, &["doctor", "--json", "--config", "aggregator.toml"]);
    assert_eq!(end.code(), 0, "{}", end.log);
    let report: Value = serde_json::from_str(&end.log).unwrap_or_else(|error| panic!("{error}: {}", end.log));
    assert_eq!(report["healthy"], true);
    assert_eq!(report["database"]["integrity"]["problems"].as_array().map(Vec::len), Some(0));
    let node = report["database"]["tables"]
        .as_array()
        .and_then(|tables| tables.iter().find(|table| table["table"] == "node"));
    assert!(node.and_then(|node| node["rows"].as_u64()).is_some_and(|rows| rows > 1_000), "{report}");
    let doctor = run(&deployment, &["doctor", "--config", "edge.toml"]);
    assert_eq!(doctor.code(), 0, "{}", doctor.log);
    assert!(doctor.log.contains("stream"), "{}", doctor.log);
    assert_eq!(aggregator.stop().code(), 0);
    assert_eq!(edge.stop().code(), 0);

    // Undelivered batches wait in the agent's spool. `doctor` finds that the last byte of one batch was replaced.
    let file = deployment.folder().join("edge/spool.sqlite");
    let waiting = query_number(&file, "SELECT count(*) FROM batch");
    assert!(waiting > 0);
    let end = run(&deployment, &["doctor", "--json", "--spool", "edge/spool.sqlite"]);
    let report: Value = serde_json::from_str(&end.log).unwrap_or_else(|error| panic!("{error}: {}", end.log));
    assert_eq!((end.code(), report["spool"]["batches"].as_u64()), (0, Some(waiting)));
    change_database(
        &file,
        "UPDATE batch SET body = CAST(substr(body, 1, length(body) - 1) || x'ff' AS BLOB) \
         WHERE number = (SELECT max(number) FROM batch)",
    );
    let end = run(&deployment, &["doctor", "--spool", "edge/spool.sqlite"]);
    assert_eq!(end.code(), 65, "{}", end.log);
    assert!(end.log.contains("changed after they were spooled"), "{}", end.log);

    let end = run(&deployment, &["backup", "--database", "aggregator.sqlite", "damaged.sqlite"]);
    assert_eq!(end.code(), 0, "{}", end.log);
    damage_table(&deployment.folder().join("damaged.sqlite"), "node");
    let end = run(&deployment, &["doctor", "--database", "damaged.sqlite"]);
    assert_eq!(end.code(), 65, "{}", end.log);
    assert!(end.log.contains("damaged") && end.log.contains("restore"), "{}", end.log);
    assert_eq!(run(&deployment, &["doctor", "--database", "none.sqlite"]).code(), 69);
    assert_eq!(run(&deployment, &["doctor"]).code(), 64);
    assert_eq!(run(&deployment, &["doctor", "--config", "none.toml"]).code(), 78);
}

#[test]
fn database_has_one_writing_process() {
    let (deployment, aggregator, edge, _api) = start_measuring();
    let rebuild = run(&deployment, &["rebuild-rollups", "--config", "aggregator.toml"]);
    assert_eq!(rebuild.code(), 69, "{}", rebuild.log);
    let holder = format!("pid {}", aggregator.pid());
    assert!(rebuild.log.contains("in use") && rebuild.log.contains(&holder), "{}", rebuild.log);
    let second_aggregator =
        AGGREGATOR.replace("{events}", &free_port().to_string()).replace("{http}", &free_port().to_string());
    deployment.write("other.toml", &second_aggregator);
    let second = deployment.start("other.toml").wait_for_end();
    assert_eq!(second.code(), 69, "{}", second.log);
    assert!(second.log.contains("in use") && second.log.contains(&holder), "{}", second.log);
    assert_eq!(edge.stop().code(), 0);
    assert_eq!(aggregator.stop().code(), 0);
}

#[test]
fn rebuilt_rollups_equal_original_statistics() {
    let (deployment, aggregator, edge, _api) = start_measuring();
    assert_eq!(edge.stop().code(), 0);
    assert_eq!(aggregator.stop().code(), 0);
    let path = database_path(&deployment);
    let before = statistics(&path);
    assert!(!before.is_empty());
    let end = run(&deployment, &["rebuild-rollups", "--database", "aggregator.sqlite"]);
    assert_eq!(end.code(), 0, "{}", end.log);
    assert_eq!(statistics(&path), before);
    change_database(&path, "DELETE FROM rollup");
    let end = run(&deployment, &["rebuild-rollups", "--config", "aggregator.toml", "--run", "1"]);
    assert_eq!(end.code(), 0, "{}", end.log);
    assert_eq!(statistics(&path), before);
    let unknown_run = run(&deployment, &["rebuild-rollups", "--config", "aggregator.toml", "--run", "99"]);
    assert_eq!(unknown_run.code(), 64, "{}", unknown_run.log);
}
