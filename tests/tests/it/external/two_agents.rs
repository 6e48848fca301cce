//! Sensor and actuator on the edge, model on the cloud.

use peernet_tests::Site;

use super::{build, figures, finished};

const CLOUD: &str = r#"
[agent]
name = "cloud"
state_dir = "{folder}/cloud"
aggregator = "tcp://127.0.0.1:{events}"

[serve]
listen = "tcp://127.0.0.1:{data}"

[[model]]
name = "brightness"
kind = "exec"
command = ["./brightness"]
folder = "{folder}"
"#;

const EDGE: &str = r#"
[agent]
name = "edge"
state_dir = "{folder}/edge"
aggregator = "tcp://127.0.0.1:{events}"

[[pipeline]]
name = "light"
sensor = { kind = "exec", command = ["{root}/docs/examples/external/light.sh"] }
placement = { kind = "remote", peer = "tcp://127.0.0.1:{data}", model = "brightness" }
actuator = { kind = "exec", command = "{root}/docs/examples/external/record.sh {folder}/answers.txt" }
warm_up = { iterations = 2 }
limit = { total = 42 }
"#;

#[test]
fn a_picture_from_shell_is_judged_by_c_and_recorded_by_shell() {
    let site = Site::new();
    let (_aggregator, api) = site.aggregator();
    build(&site);
    site.write("cloud.toml", CLOUD);
    site.write("edge.toml", EDGE);
    let cloud = site.start("cloud.toml");
    let edge = site.start("edge.toml");
    let run = finished(&api);

    let detail = api.json(&format!("/api/v1/runs/{run}"));
    assert_eq!(
        (detail["counts"]["ok"].as_u64(), detail["warm_up"].as_u64()),
        (Some(40), Some(2)),
        "{detail}"
    );
    let facts = detail["facts"].to_string();
    assert!(facts.contains("light.sh") && facts.contains("./brightness"), "{facts}");

    // Every answer was right, and that crossed the wire: the edge knows the label, the cloud gave the answer.
    for name in ["top-1", "top-5"] {
        let right = figures(&api, run, name).unwrap_or_else(|| panic!("{name} is missing"));
        assert_eq!((right["count"].as_u64(), right["mean"].as_f64()), (Some(40), Some(1.0)), "{right}");
    }
    // What the program told of itself, and what the way to it cost; together they are the whole.
    let mean = |name: &str| figures(&api, run, name).and_then(|stage| stage["mean"].as_f64());
    let names = [
        "sensing",
        "encode",
        "upload",
        "queue",
        "inference",
        "postprocessing",
        "ipc",
        "download",
        "actuation",
        "unattributed",
    ];
    let sum: f64 = names.iter().map(|name| mean(name).unwrap_or_else(|| panic!("{name} is missing"))).sum();
    let total = mean("total").expect("always recorded");
    assert!((sum - total).abs() < 1e-9, "{sum} is not {total}");
    assert_eq!(mean("dropped-samples"), Some(0.0));

    let answers = std::fs::read_to_string(site.folder().join("answers.txt")).expect("was written");
    let lines: Vec<&str> = answers.lines().collect();
    assert_eq!(lines.len(), 42, "{answers}");
    for (index, line) in lines.iter().enumerate() {
        let label = if index % 2 == 0 { "dark" } else { "bright" };
        let expected = format!("picture-{} {{\"label\":\"{label}\"", index + 1);
        assert!(line.starts_with(&expected), "{line}");
    }
    assert_eq!(edge.stop().code(), 0);
    assert_eq!(cloud.stop().code(), 0);
}
