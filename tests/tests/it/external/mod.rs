//! The example programs of the docs in real agents: a sensor in shell, a model in C, an actuator in shell.

mod alone;
mod failing;
mod two_agents;

use std::path::PathBuf;
use std::process::Command;

use peernet_tests::{Api, Site, root};
use serde_json::Value;

/// Builds the model in C as its first lines say, into the site's folder.
fn build(site: &Site) -> PathBuf {
    let program = site.folder().join("brightness");
    let source = root().join("docs/examples/external/brightness.c");
    let built = Command::new("cc").args(["-O2", "-Wall", "-Werror", "-o"]).arg(&program).arg(source).output();
    let built = built.expect("a C compiler is there: apt-get install gcc");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    program
}

/// The number of the only run, once it has ended well.
fn finished(api: &Api) -> i64 {
    api.until("/api/v1/runs", |runs| {
        let run = runs["runs"].get(0)?;
        (run["reason"] == "finished").then(|| run["number"].as_i64())?
    })
}

/// The figures of a stage or value of a run.
fn figures(api: &Api, run: i64, name: &str) -> Option<Value> {
    let stages = api.json(&format!("/api/v1/runs/{run}/stages"));
    stages["stages"].as_array()?.iter().find(|stage| stage["name"] == name).cloned()
}
