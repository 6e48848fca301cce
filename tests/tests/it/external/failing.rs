//! Test of programs that fail: only their iterations fail.

use peernet_tests::LoopbackDeployment;

/// Model that fails once in each of five ways, and answers all other requests.
const MODEL: &str = r#"#!/bin/sh
step=$(cat step 2> /dev/null || echo 0)
while read -r word bytes media shape source; do
    head -c "$bytes" > /dev/null
    step=$((step + 1))
    echo "$step" > step
    case $step in
    2) echo "Loading weights..." ;;
    4) echo "out of paper" >&2; exit 9 ;;
    6) sleep 600 ;;
    8) echo "error too dark" ;;
    10) echo "answer 99999999999999" ;;
    *) echo "answer 2"; printf ok ;;
    esac
done
"#;

const EDGE: &str = r#"
[[model]]
name = "moody"
kind = "exec"
command = "sh moody.sh"
folder = "{folder}"
timeout_ms = 500

[[pipeline]]
name = "line"
sensor = { kind = "text", length = 20 }
placement = { kind = "local", model = "moody" }
timeout_ms = 60000
warm_up = { iterations = 0 }
limit = { total = 20 }
"#;

#[test]
fn each_failure_is_one_iteration_with_its_reason() {
    let deployment = LoopbackDeployment::new();
    let (_aggregator, api) = deployment.start_aggregator();
    deployment.write("moody.sh", MODEL);
    let edge = deployment.start_agent("edge", EDGE);
    let run = api.wait_for_finished_run();

    let detail = api.json(&format!("/api/v1/runs/{run}"));
    let counts = &detail["counts"];
    assert_eq!((counts["ok"].as_u64(), counts["failed"].as_u64()), (Some(15), Some(5)), "{detail}");
    for (number, parts) in [
        (2, ["Loading weights...", "standard error"]),
        (4, ["exit status 9", "out of paper"]),
        (6, ["within 500ms", "killed"]),
        (8, ["the program says", "too dark"]),
        (10, ["99999999999999", "at most"]),
    ] {
        let iteration = api.json(&format!("/api/v1/runs/{run}/iterations/{number}"));
        let text = iteration["outcome"].to_string() + &iteration["reason"].to_string();
        for part in parts {
            assert!(text.contains(part), "{part} is missing in {text}");
        }
    }
    assert_eq!(edge.stop().code(), 0);
}
