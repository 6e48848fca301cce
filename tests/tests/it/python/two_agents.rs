//! From a Python sensor over the network to a Python model and back, into the store.

use serde_json::Value;

use super::{CLOUD, EDGE, site, write};

fn mean(stages: &[Value], name: &str) -> f64 {
    let stage = stages.iter().find(|stage| stage["name"] == name);
    stage
        .and_then(|stage| stage["mean"].as_f64())
        .unwrap_or_else(|| panic!("{name} is missing in {stages:?}"))
}

#[test]
fn arrays_go_up_and_each_step_of_the_users_is_a_stage() {
    let site = site();
    let (_aggregator, api) = site.aggregator();
    write(&site, "cloud.toml", CLOUD);
    write(
        &site,
        "edge.toml",
        &format!("{EDGE}limit = {{ iterations = 30 }}\nactuator = {{ kind = \"log\" }}\n"),
    );
    let cloud = site.start("cloud.toml");
    let edge = site.start("edge.toml");
    edge.wait_for("the rig is up");
    let run = api.until("/api/v1/runs", |runs| {
        let run = runs["runs"].get(0)?;
        (run["reason"] == "finished").then(|| run["number"].as_i64())?
    });

    // Every tenth sample failed, with the user's own words; the others went on.
    let detail = api.json(&format!("/api/v1/runs/{run}"));
    assert_eq!(detail["counts"]["failed"], 3, "{detail}");
    assert_eq!(detail["counts"]["ok"], 27, "{detail}");
    let facts = detail["facts"].to_string();
    for fact in ["class rig::Rig", "class follower::Follower", "Python 3."] {
        assert!(facts.contains(fact), "{fact} is missing in {facts}");
    }
    let failed = api.json(&format!("/api/v1/runs/{run}/iterations/10"));
    let said = failed["outcome"].to_string() + &failed["reason"].to_string();
    assert!(said.contains("the path is lost at 10") && said.contains("follower.py"), "{failed}");

    // What the process border costs is told apart, and the sum is whole.
    let stages = api.json(&format!("/api/v1/runs/{run}/stages"));
    let stages = stages["stages"].as_array().expect("a list");
    let names =
        ["sensing", "encode", "upload", "queue", "ipc", "preprocessing", "inference", "postprocessing"];
    let sum: f64 = names.iter().chain(&["download", "actuation"]).map(|name| mean(stages, name)).sum();
    let total = mean(stages, "total");
    let rest = mean(stages, "unattributed");
    assert!((sum + rest - total).abs() < 1e-9, "{sum} + {rest} is not {total}");
    assert!(mean(stages, "capture-ipc") <= mean(stages, "capture"), "{stages:?}");

    cloud.wait_for("following on cuda:0");
    assert_eq!(edge.stop().code(), 0);
    assert_eq!(cloud.stop().code(), 0);
}
