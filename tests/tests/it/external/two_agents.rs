//! Test with sensor and actuator on the edge and model on the cloud.

use peernet_tests::{Network, TwoHostTestbed};

use super::build_example;

const MODEL: &str = r#"
[[model]]
name = "brightness"
kind = "exec"
command = ["./brightness"]
folder = "{folder}"
"#;

const LIGHT: &str = r#"
[[pipeline]]
name = "light"
sensor = { kind = "exec", command = ["{root}/docs/examples/external/light.sh"] }
placement = { kind = "remote", peer = "PEER", model = "brightness" }
actuator = { kind = "exec", command = "{root}/docs/examples/external/record.sh {folder}/answers.txt" }
warm_up = { iterations = 2 }
limit = { total = 42 }
"#;

#[test]
fn shell_sensor_c_model_shell_actuator_work_together() {
    let testbed = TwoHostTestbed::new(|_| Network::direct());
    build_example(testbed.folder());
    let cloud = testbed.start_cloud(MODEL);
    let edge = testbed.start_edge(&LIGHT.replace("PEER", &testbed.peer()), &[]);
    let api = &testbed.api;
    let run = api.wait_for_finished_run();

    let detail = api.json(&format!("/api/v1/runs/{run}"));
    assert_eq!(
        (detail["counts"]["ok"].as_u64(), detail["warm_up"].as_u64()),
        (Some(40), Some(2)),
        "{detail}"
    );
    let facts = detail["facts"].to_string();
    for file in ["/light.sh SHA-256 ", "/brightness SHA-256 ", "/record.sh SHA-256 "] {
        assert!(facts.contains(file), "{file}: {facts}");
    }

    // Every answer was right. The edge compares the label, which its sensor states, with the answer of
    // the cloud's model. Samples and answers thus crossed the network unaltered.
    let statistics = api.stage_statistics(run, "top-1").expect("samples have labels");
    assert_eq!(
        (statistics["count"].as_u64(), statistics["mean"].as_f64()),
        (Some(40), Some(1.0)),
        "{statistics}"
    );
    assert!(api.stage_statistics(run, "top-5").is_none(), "the program has two classes");
    // The program reports the stages `inference` and `postprocessing`. The stage `ipc` is the time for sending the
    // request to the program and receiving its reply.
    let edge_stages = ["sensing", "encode", "upload", "download", "actuation"];
    let cloud_stages = ["queue", "inference", "postprocessing", "ipc"];
    api.assert_stages_sum_to_total(run, &[&edge_stages[..], &cloud_stages].concat());
    assert_eq!(api.mean(run, "dropped-samples"), 0.0);

    let answers = std::fs::read_to_string(testbed.folder().join("answers.txt")).expect("was written");
    let lines: Vec<&str> = answers.lines().collect();
    assert_eq!(lines.len(), 42, "{answers}");
    for (index, line) in lines.iter().enumerate() {
        let label = if index % 2 == 0 { "dark" } else { "bright" };
        let expected = format!("picture-{} {{\"label\":\"{label}\"", index + 1);
        assert!(line.starts_with(&expected), "{line}");
    }
    assert_eq!(edge.stop().code(), 0);
    assert_eq!(cloud.stop().code(), 0);
    testbed.stop();
}
