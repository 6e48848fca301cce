//! Tests of programs' arguments, which may be secret.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use peernet_tests::{LoopbackDeployment, Process, program, root};
use serde_json::Value;

use crate::experiments::{Results, json};

const SECRET: &str = "hunter2-in-an-argument";

/// Custom programs, with a secret in each argument that can contain one.
const TABLES: &str = r#"
[[model]]
name = "own"
kind = "exec"
command = "while read word bytes rest; do head -c $bytes >/dev/null; : {secret}; echo answer 1 text/plain && printf b; done"

[[pipeline]]
name = "first"
sensor = { kind = "exec", command = ["{root}/docs/examples/external/light.sh", "--token", "{secret}"] }
placement = { kind = "local", model = "own" }
actuator = { kind = "exec", command = ["sh", "-c", "while read w b r; do head -c $b >/dev/null; echo done; done", "{secret}"] }
limit = { total = 10 }

[[pipeline]]
name = "second"
sensor = { kind = "exec", command = ["{root}/docs/examples/external/light.sh", "--token", "{secret}"] }
placement = { kind = "none" }
limit = { total = 10 }

[[pipeline]]
name = "third"
sensor = { kind = "exec", command = ["{root}/docs/examples/external/light.sh", "--token", "another"] }
placement = { kind = "none" }
limit = { total = 10 }

[[pipeline]]
name = "failing"
sensor = { kind = "exec", command = ["false", "{secret}"] }
placement = { kind = "none" }
limit = { total = 3 }
"#;

fn fact_value<'a>(run: &'a Value, name: &str) -> Option<&'a str> {
    let facts = run["facts"].as_array()?;
    facts.iter().find(|fact| fact["name"] == name)?["value"].as_str()
}

#[test]
fn arguments_are_published_as_fingerprints() {
    let deployment = LoopbackDeployment::new();
    let (aggregator, api) = deployment.start_aggregator();
    let edge = deployment.start_agent("edge", &TABLES.replace("{secret}", SECRET));
    let runs = api.wait_until("/api/v1/runs", |runs| {
        let runs = runs["runs"].as_array()?;
        let have_ended = runs.len() == 4 && runs.iter().all(|run| !run["reason"].is_null());
        have_ended.then(|| {
            runs.iter().map(|run| run["number"].as_i64().expect("a run has a number")).collect::<Vec<_>>()
        })
    });
    // A run of this length may be stored before its pipeline has reported.
    api.wait_until("/api/v1/pipelines", |pipelines| {
        (pipelines["pipelines"].as_array()?.len() == 4).then_some(())
    });
    let run_details: Vec<Value> = runs.iter().map(|run| api.json(&format!("/api/v1/runs/{run}"))).collect();
    let run_of = |pipeline: &str| {
        run_details.iter().find(|run| run["pipeline"] == pipeline).expect("the pipeline has a run")
    };

    let arguments =
        ["first", "second", "third"].map(|pipeline| fact_value(run_of(pipeline), "Sensor arguments"));
    assert!(arguments[0].is_some_and(|value| value.starts_with("2, fingerprint ")), "{arguments:?}");
    assert_eq!(arguments[0], arguments[1], "equal commands have equal fingerprints");
    assert_ne!(arguments[0], arguments[2], "different commands have different fingerprints");
    let first_run = run_of("first");
    assert!(fact_value(first_run, "Sensor").is_some_and(|value| value.ends_with("/light.sh")), "{first_run}");
    assert!(
        fact_value(first_run, "Model arguments").is_some()
            && fact_value(first_run, "Actuator arguments").is_some(),
        "{first_run}"
    );
    assert!(
        first_run["configuration"].as_str().is_some_and(|text| text.contains("arguments = 2")),
        "{first_run}"
    );

    let mut paths: Vec<String> = [
        "/",
        "/runs",
        "/pipelines",
        "/hosts",
        "/incidents",
        "/metrics",
        "/api/v1/runs",
        "/api/v1/pipelines",
        "/api/v1/hosts",
        "/api/v1/incidents",
        "/pipelines/edge/first",
        "/pipelines/edge/failing",
    ]
    .map(str::to_owned)
    .into();
    for run in &runs {
        paths.extend([
            format!("/runs/{run}"),
            format!("/api/v1/runs/{run}"),
            format!("/api/v1/runs/{run}/iterations"),
        ]);
    }
    for path in paths {
        let (status, text) = api.get(&path).expect("the dashboard answers");
        assert_eq!(status, 200, "{path}");
        assert!(!text.contains(SECRET), "{path} shows the argument");
    }
    let end = edge.stop();
    assert!(!end.log.contains(SECRET), "{}", end.log);
    assert_eq!(aggregator.stop().code(), 0);
    // The database does not contain the secret either.
    let mut database = Vec::new();
    for file in std::fs::read_dir(deployment.folder()).expect("the folder exists") {
        let path = file.expect("is readable").path();
        if path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("aggregator.sqlite")) {
            database.extend(std::fs::read(&path).expect("is readable"));
        }
    }
    let contains = |text: &str| database.windows(text.len()).any(|window| window == text.as_bytes());
    assert!(contains("failing"), "the files of the database lack the name of a pipeline");
    assert!(!contains(SECRET), "the database contains the argument");
}

const EXPERIMENT: &str = r#"
[experiment]
name = "arguments"
iterations = 3

[pipeline]
placement = { kind = "none" }
sensor = { kind = "exec", command = ["{root}/docs/examples/external/light.sh", "{secret}"] }
"#;

#[test]
fn run_json_with_arguments_is_closed_to_others() {
    let deployment = LoopbackDeployment::new();
    let file = deployment.write("arguments.toml", &EXPERIMENT.replace("{secret}", SECRET));
    let results = Results::of(deployment.folder().join("results"));
    let arguments = [Path::new("run"), &file, Path::new("--result-loc"), &results.folder];
    let state = deployment.folder().display().to_string();
    let environment = [("XDG_STATE_HOME", state.as_str())];
    let end = Process::start(&program("peernet"), &arguments, root(), &environment).wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);

    let run = &results.folders()[0];
    let file = results.file(run, "run.json");
    let record = json(&file);
    assert_eq!(record["pipeline"]["sensor"]["command"][1], SECRET, "{record}");
    assert!(!record["facts"].to_string().contains(SECRET), "{record}");
    let mode = std::fs::metadata(&file).expect("the file exists").permissions().mode();
    assert_eq!(mode & 0o007, 0, "{mode:o}");
    for table in ["summary.md", "summary.csv", "data.csv"] {
        let text = std::fs::read_to_string(results.file(run, table)).expect("the file exists");
        assert!(!text.contains(SECRET), "{table}");
    }
}
