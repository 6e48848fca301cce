//! Test of the example in docs/controllers.md against the answers of the API.

use std::io::Write;
use std::process::{Command, Stdio};

use serde_json::{Value, json};

use crate::test_dashboard::TestDashboard;
use crate::test_site::TestPipeline;

/// Calls the documented `decide` for each line of the input: an answer, and the names of two pipelines. Then calls
/// `ask` without a server.
const DRIVER: &str = r#"
import json, sys
for line in sys.stdin:
    answer, LOCAL, CLOUD = json.loads(line)
    LOCAL, CLOUD = tuple(LOCAL), tuple(CLOUD)
    print(decide(answer))
ASK = "http://127.0.0.1:1/"
print(decide(ask()))
"#;

#[tokio::test]
async fn documented_controller_decides_by_known_values() {
    let (dashboard, _site) =
        TestDashboard::with_pipelines(vec![TestPipeline::local(), TestPipeline::full()]).await;
    let mut answer = dashboard.get("/api/v1/pipelines?window=10&stage=total").await.json();
    for pipeline in answer["pipelines"].as_array_mut().expect("pipelines") {
        // On a slow test machine, the state may no longer be `running` by now.
        pipeline["state"] = json!("running");
    }
    let name = |at: usize| json!([answer["pipelines"][at]["host"], answer["pipelines"][at]["name"]]);
    let (local, cloud) = (name(0), name(1));
    let answer_with = |change: &dyn Fn(&mut Value)| {
        let mut changed = answer.clone();
        let window = &mut changed["pipelines"][1]["windows"][0];
        (window["values"][0]["p95"], window["lost_fraction"]) = (json!(0.001), json!(0.0));
        change(&mut changed["pipelines"][1]);
        changed
    };
    let cases = [
        (answer_with(&|_| {}), "cloud"),
        (answer_with(&|pipeline| pipeline["windows"][0]["values"][0]["p95"] = json!(9.0)), "local"),
        (answer_with(&|pipeline| pipeline["state"] = json!("away")), "local"),
        (answer_with(&|pipeline| pipeline["windows"][0]["values"] = json!([])), "local"),
        (answer_with(&|pipeline| pipeline["windows"][0]["values"][0]["p95"] = Value::Null), "local"),
        (answer_with(&|pipeline| pipeline["windows"][0]["lost_fraction"] = json!(0.5)), "local"),
        (answer_with(&|pipeline| pipeline["windows"][0]["lost_fraction"] = Value::Null), "local"),
        (json!({ "pipelines": [] }), "local"),
    ];

    let page = include_str!("../../../docs/controllers.md");
    let (_, rest) = page.split_once("```python\n").expect("an example");
    let (example, _) = rest.split_once("```").expect("the end of the example");
    // The loop of the example starts only if the module's name is `__main__`.
    let example = example.replace("__main__", "not run here");
    let mut python = Command::new("python3")
        .args(["-c", &format!("{example}{DRIVER}")])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("python3 starts");
    let mut input = python.stdin.take().expect("the input is piped");
    for (answer, _) in &cases {
        writeln!(input, "{}", json!([answer, local, cloud])).expect("it reads");
    }
    drop(input);
    let output = python.wait_with_output().expect("it ends");
    let decided = String::from_utf8(output.stdout).expect("text");
    let expected: Vec<&str> = cases.iter().map(|(_, expected)| *expected).chain(["local"]).collect();
    assert_eq!(decided.lines().collect::<Vec<_>>(), expected, "the last decision is made without an answer");
}
