//! Test of several users of one cloud.

use std::path::Path;

use chrono::DateTime;
use peernet_tests::{Process, program};

use super::{Lab, column, json};

/// Documented commands that this test executes.
pub(crate) const COMMANDS: [&str; 1] = ["peernet plot --kind users"];

const USERS: &str = r#"
[experiment]
name = "users"
order = "declared"
duration_s = 1.5

[agent]
name = "robot"

[pipeline]
sensor = { kind = "text", length = 500 }
placement = { kind = "remote", peer = "{cloud}", model = "slow" }

[[axis]]
name = "Users"
field = "experiment.users"
values = [1, 3]
"#;

#[test]
fn fairness_between_three_users_is_reported() {
    let lab = Lab::new();
    let end = lab.run(USERS, &[]).wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    let folders = lab.results.folders();
    assert_eq!(folders, ["001-1-r1", "002-3-r1"]);
    let users = [1, 2, 3].map(|user| json(&lab.results.file(&folders[1], &format!("user-{user}/run.json"))));
    let names = users.each_ref().map(|user| user["edge"]["name"].as_str().expect("a name"));
    assert_eq!(names, ["robot-1", "robot-2", "robot-3"]);
    assert_eq!(users[1]["user"], serde_json::json!({ "number": 2, "of": 3 }));
    let seeds = users.each_ref().map(|user| user["seeds"]["sensor"].as_u64().expect("a number"));
    assert!(seeds[0] != seeds[1] && seeds[1] != seeds[2], "each user has a separate seed: {seeds:?}");

    let table = lab.results.folder.join("users.csv");
    assert_eq!(column(&table, "edges"), ["1", "3"]);
    let numbers = |name: &str| -> Vec<f64> {
        column(&table, name).iter().map(|cell| cell.parse().expect("a number")).collect()
    };
    let (fairness, latency, rate) = (numbers("fairness"), numbers("total-p50"), numbers("rate"));
    assert!(
        (fairness[0] - 1.0).abs() < 1e-9 && (1.0 / 3.0..1.0 + 1e-9).contains(&fairness[1]),
        "{fairness:?}"
    );
    // There is one worker, and a sample takes 40 ms: one user never waits; of three, one is served and two wait.
    assert!(latency[0] >= 0.04 && latency[1] > latency[0], "{latency:?}");
    assert!(rate[1] <= 25.5, "one worker answers at most 25 requests per second: {rate:?}");
    // The users of one run are one line of the table, and one run.
    assert_eq!(column(&lab.results.folder.join("compare.csv"), "runs"), ["1", "1"]);
    let trust_line = end
        .log
        .lines()
        .find(|line| line.starts_with("Can they be published?"))
        .expect("the verdict is printed");
    // The line has the number of runs for each verdict.
    let numbers = trust_line.split_whitespace().filter_map(|word| word.parse::<u32>().ok());
    assert_eq!(numbers.sum::<u32>(), 2, "two runs, however many edges: {trust_line}");
    draw_again(&lab);
}

/// Sensor whose instances number themselves at their first sample. Instance 0 belongs to the trial. Instance 1 belongs to one
/// of the two edges, and is slow.
const UNEQUAL_SENSOR: &str = r#"
import os, time

class Camera:
    def __init__(self):
        self.number = None

    def sample(self):
        while self.number is None:
            for number in range(100):
                try:
                    os.mkdir(f"{FOLDER}/{number}")
                except FileExistsError:
                    continue
                self.number = number
                break
        time.sleep(0.15 if self.number == 1 else 0.005)
        return {"number": self.number}
"#;

const UNEQUAL: &str = r#"
[experiment]
name = "unequal"
iterations = 10
warm_up = { iterations = 0 }
users = 2

[pipeline]
sensor = { kind = "python", object = "camera::Camera" }
placement = { kind = "none" }
"#;

#[test]
fn no_edge_writes_results_while_another_measures() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path();
    let sensor = format!("FOLDER = {:?}\n{UNEQUAL_SENSOR}", path.display().to_string());
    for (name, text) in [("camera.py", sensor.as_str()), ("unequal.toml", UNEQUAL)] {
        std::fs::write(path.join(name), text).expect("writable");
    }
    let state = path.join("state").display().to_string();
    let environment = [("PEERNET_PYTHON", "/usr/bin/python3"), ("XDG_STATE_HOME", &*state)];
    let end =
        Process::start(&program("peernet"), &["run", "unequal.toml"], path, &environment).wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    let run = path.join("results/unequal/runs/001-r1");
    let users = [1, 2].map(|user| run.join(format!("user-{user}")));
    let ends = users.each_ref().map(|user| {
        let ended = json(&user.join("run.json"))["ended"].as_str().expect("it has ended").to_owned();
        DateTime::parse_from_rfc3339(&ended).expect("a time").to_utc()
    });
    assert!((ends[0] - ends[1]).abs().num_milliseconds() > 500, "one edge is slower: {ends:?}");
    for user in &users {
        for file in ["run.json", "summary.csv", "sensing-time.svg"] {
            let written =
                std::fs::metadata(user.join(file)).and_then(|file| file.modified()).expect("written");
            assert!(
                ends.iter().all(|end| DateTime::<chrono::Utc>::from(written) >= *end),
                "{user:?}, {file}: {written:?}, {ends:?}"
            );
        }
    }
}

/// Deletes the figure over the number of users, and checks that the documented command draws it again.
fn draw_again(lab: &Lab) {
    let figure = lab.results.folder.join("users.svg");
    std::fs::remove_file(&figure).expect("the experiment drew the figure");
    let [command] = COMMANDS;
    let options = command.split(' ').skip(1).map(Path::new);
    let arguments: Vec<&Path> = options.chain([lab.results.folder.as_path()]).collect();
    let edge = lab.network.edge();
    let plot = edge.start(&program("peernet"), &arguments, lab.deployment.folder(), &[]).wait_for_end();
    assert_eq!(plot.code(), 0, "{}", plot.log);
    assert!(figure.is_file(), "{}", plot.log);
}
