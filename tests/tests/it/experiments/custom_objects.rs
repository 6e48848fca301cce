//! Tests of experiments with custom sensors, models and actuators in Python on one machine.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use peernet_tests::{Document, Process, ProcessEnd, free_port, program};

use super::{column, json};

/// Runs `peernet run arm.toml` in a folder with these objects in `arm.py`.
fn run(folder: &Path, objects: &str, experiment: &str) -> ProcessEnd {
    fs::write(folder.join("arm.py"), objects).expect("writable");
    fs::write(folder.join("arm.toml"), experiment).expect("writable");
    let state = folder.join("state").display().to_string();
    let environment = [("PEERNET_PYTHON", "/usr/bin/python3"), ("XDG_STATE_HOME", &*state)];
    Process::start(&program("peernet"), &["run", "arm.toml"], folder, &environment).wait_for_end()
}

/// Returns the objects and the experiment that the document shows, with a port that no other test uses.
fn documented_files() -> (String, String) {
    let document = Document::read("docs/actuators.md");
    let block = |language: &str, part: &str| {
        let blocks = document.fenced_blocks(language).into_iter().map(|(_, text)| text);
        blocks.into_iter().find(|text| text.contains(part)).expect("the document has it")
    };
    let port = free_port().to_string();
    (block("python", "class Motor").replace("9005", &port), block("toml", "arm::Motor"))
}

#[test]
fn documented_arm_reaches_its_target() {
    let folder = tempfile::tempdir().expect("a folder");
    let (objects, experiment) = documented_files();
    let end = run(folder.path(), &objects, &experiment);
    assert_eq!(end.code(), 0, "{}", end.log);
    let rates = column(&folder.path().join("results/arm/compare.csv"), "success-rate");
    assert_eq!(rates, ["1"], "{}", end.log);
}

#[test]
fn trial_finds_mistakes_of_python_objects() {
    let folder = tempfile::tempdir().expect("a folder");
    let (objects, experiment) = documented_files();
    let assert_reported = |objects: &str, experiment: &str, expected: &[&str]| {
        let end = run(folder.path(), objects, experiment);
        assert!(matches!(end.code(), 69 | 75), "{}: {}", end.code(), end.log);
        for text in expected {
            assert!(end.log.contains(text), "{text} is not in {}", end.log);
        }
        // A trial that failed says nothing about the duration.
        assert!(end.log.contains("how long it takes is not known"), "{}", end.log);
        assert!(!end.log.contains("begins"), "nothing was measured: {}", end.log);
    };
    assert_reported(
        &format!("import no_such_package\n{objects}"),
        &experiment,
        &[
            "cannot start arm::Motor with /usr/bin/python3: ModuleNotFoundError: No module named 'no_such_package'",
            "with the key python or the variable PEERNET_PYTHON",
            "Traceback",
        ],
    );
    let actuator_key = "actuator = { kind = \"python\", object = \"arm::Motor\" }";
    assert_reported(
        &format!("import no_such_package\n{objects}"),
        &experiment.replace(actuator_key, ""),
        &["cannot start arm::Arm with /usr/bin/python3: ModuleNotFoundError", "PEERNET_PYTHON"],
    );
    assert_reported(
        &objects,
        &experiment.replace("arm::Motor", "arm::Moter"),
        &["the actuator cannot be created: ", "arm::Moter"],
    );
    assert_reported(
        &objects,
        &experiment
            .replace(actuator_key, "actuator = { kind = \"socket\", address = \"tcp://127.0.0.1:1\" }"),
        &["the actuator cannot be created: ", "cannot connect to the controller at tcp://127.0.0.1:1"],
    );
    let return_statement = "            return {\"position\": self.position}";
    assert_reported(
        &objects.replacen(return_statement, "            raise RuntimeError('no action yet')", 1),
        &experiment,
        &["the sensor failed: RuntimeError: no action yet", "a trial runs without the actuator"],
    );
}

#[test]
fn failed_action_is_named_as_such() {
    let folder = tempfile::tempdir().expect("a folder");
    let (objects, experiment) = documented_files();
    let act = "        self.arm.sendto(json.dumps(answer).encode(), ARM)";
    let objects = objects.replacen(act, "        raise RuntimeError('the brake is on')", 1);
    // There is no limit of failures: the run ends at its limit of iterations, although every action fails.
    let experiment = experiment
        .replace("episodes = 5\nepisode_steps = 20", "iterations = 2\nwarm_up = { iterations = 0 }");
    let end = run(folder.path(), &objects, &experiment);
    assert_eq!(end.code(), 75, "{}", end.log);
    let text = "iterations failed (the actuator failed to act on the answer); iteration 1 failed: the actuator failed: \
                RuntimeError: the brake is on";
    assert!(end.log.contains(text), "{}", end.log);
    // The first reason is printed as soon as it is known, before the end of the run.
    let first_reason = "): iteration 1 failed: the actuator failed: RuntimeError: the brake is on";
    assert_eq!(end.log.matches(first_reason).count(), 1, "{}", end.log);
    assert!(end.log.contains("iterations failed in 1 run"), "{}", end.log);
    // The report calls the failures errors of custom code, and not missing answers.
    let report = "2 of 2 iterations failed (100\u{202f}%): 2 with an error of sensor, model or actuator.";
    let runs = fs::read_dir(folder.path().join("results/arm/runs")).expect("a folder of runs");
    let records: Vec<String> = runs
        .map(|run| fs::read_to_string(run.expect("a run").path().join("run.json")).expect("a record"))
        .collect();
    assert!(!records.is_empty() && records.iter().all(|record| record.contains(report)), "{records:?}");
}

/// Objects that append environment variables of their process to the file `variables`.
const RECORDING_OBJECTS: &str = "
import os

def record(role):
    numbers = [os.environ['PEERNET_' + name] for name in ('REPEAT', 'USER', 'SEED')]
    with open('variables', 'a') as file:
        file.write(' '.join([role, *numbers]) + '\\n')

class Sensor:
    def __init__(self): record('sensor')
    def sample(self): return 1

class Model:
    def __init__(self): record('model')
    def infer(self, x): return x

class Actuator:
    def __init__(self): record('actuator')
    def act(self, answer): pass
";

const REPEATS_AND_USERS: &str = "
[experiment]
name = 'variables'
repeats = 2
users = 2
iterations = 2
plots = false

[pipeline]
sensor = { kind = 'python', object = 'arm::Sensor' }
placement = { kind = 'local', model = 'gpu' }
actuator = { kind = 'python', object = 'arm::Actuator' }

[[model]]
name = 'gpu'
kind = 'distribution'
mean_ms = 1.0
std_ms = 0.5
inner = 'own'

[[model]]
name = 'own'
kind = 'python'
object = 'arm::Model'
";

#[test]
fn repeats_and_users_have_their_own_seeds() {
    let folder = tempfile::tempdir().expect("a folder");
    let end = run(folder.path(), RECORDING_OBJECTS, REPEATS_AND_USERS);
    assert_eq!(end.code(), 0, "{}", end.log);
    let variables = fs::read_to_string(folder.path().join("variables")).expect("it was written");
    let mut seeds = BTreeSet::new();
    for (run, repeat) in [("001-r1", "1"), ("002-r2", "2")] {
        for user in ["1", "2"] {
            let path = folder.path().join(format!("results/variables/runs/{run}/user-{user}/run.json"));
            let record = json(&path);
            let seed = |name: &str| record["seeds"][name].as_u64().expect("is recorded");
            for (role, name) in [("sensor", "sensor"), ("model", "model.own"), ("actuator", "actuator")] {
                let line = format!("{role} {repeat} {user} {}\n", seed(name));
                assert!(variables.contains(&line), "{line} is not in {variables}");
                seeds.insert(seed(name));
            }
            // The run can be repeated from its record.
            let env = &record["pipeline"]["sensor"]["env"];
            assert_eq!(env["PEERNET_SEED"], seed("sensor").to_string(), "{env}");
            let facts = record["facts"].to_string();
            assert!(facts.contains(&format!("0.5 ms, seed {}\"", seed("model.gpu"))), "{facts}");
            assert_eq!(seed("model.gpu"), seed("model.own"));
        }
    }
    assert_eq!(seeds.len(), 12, "the seeds are different: {variables}");
    let table =
        fs::read_to_string(folder.path().join("results/variables/compare.txt")).expect("it was written");
    assert!(table.contains("standard deviation 0.5 ms, a seed of its own for each run"), "{table}");
}
