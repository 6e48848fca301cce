//! Test of the values that users set in `env`.

use std::path::Path;

use peernet_tests::{LoopbackDeployment, Process, program, root};

use crate::experiments::{Results, json};

const EXPERIMENT: &str = r#"
[experiment]
name = "secrets"
iterations = 3

[pipeline]
placement = { kind = "local", model = "own" }
sensor = { kind = "exec", env = { TOKEN = "{secret}" }, command = "while read x; do [ \"$TOKEN\" ] && echo answer 1 text/plain && printf a; done" }

[[model]]
name = "own"
kind = "exec"
env = { TOKEN = "{secret}" }
command = "while read word bytes rest; do head -c $bytes >/dev/null; [ \"$TOKEN\" ] && echo answer 1 text/plain && printf b; done"
"#;

#[test]
fn run_record_contains_variable_names_without_values() {
    let deployment = LoopbackDeployment::new();
    let secret = "hunter2";
    let file = deployment.folder().join("secrets.toml");
    std::fs::write(&file, EXPERIMENT.replace("{secret}", secret)).expect("writable");
    let results = Results::of(deployment.folder().join("results"));
    let arguments = [Path::new("run"), &file, Path::new("--result-loc"), &results.folder];
    let end = Process::start(&program("peernet"), &arguments, root(), &[]).wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);

    let run = &results.folders()[0];
    let record = json(&results.file(run, "run.json"));
    assert_eq!(record["counts"]["ok"], 3, "{record}");
    for table in [&record["pipeline"]["sensor"], &record["agent"]["model"][0]] {
        assert_eq!(table["env"]["TOKEN"], "(not told)", "{table}");
    }
    for file in std::fs::read_dir(results.file(run, "")).expect("is there") {
        let path = file.expect("is readable").path();
        let bytes = std::fs::read(&path).expect("is readable");
        assert!(!String::from_utf8_lossy(&bytes).contains(secret), "{}", path.display());
    }
    assert!(results.record().to_string().contains(secret), "a resumed experiment needs the value");
}
