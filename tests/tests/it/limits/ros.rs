//! Test of the memory that sessions over ROS 1 share.

use peernet_tests::{LoopbackDeployment, Ros1System};
use serde_json::Value;

const ITERATIONS: u64 = 200;

/// Returns the tables of a cloud whose memory limit permits one message of a robot, but not two at once.
fn cloud_tables(system: &Ros1System) -> String {
    format!(
        "[serve]\nlisten = \"ros1://127.0.0.1:{}/cloud\"\n\
         session = {{ max_message_bytes = 4000000, max_unfinished_bytes = 4000000 }}\n\
         [[model]]\nname = \"echo\"\nkind = \"echo\"\n",
        system.port()
    )
}

fn pipeline(system: &Ros1System, name: &str) -> String {
    format!(
        "[[pipeline]]\nname = \"{name}\"\n\
         sensor = {{ kind = \"synthetic\", size_bytes = 3000000 }}\n\
         placement = {{ kind = \"remote\", peer = \"ros1://127.0.0.1:{}/cloud\", model = \"echo\" }}\n\
         warm_up = {{ iterations = 0 }}\nlimit = {{ total = {ITERATIONS} }}\n",
        system.port()
    )
}

#[test]
fn iterations_without_memory_for_frame_are_lost() {
    let (deployment, system) = (LoopbackDeployment::new(), Ros1System::new());
    let (_aggregator, api) = deployment.start_aggregator();
    let cloud = system.start_agent(&deployment, "cloud", &cloud_tables(&system));
    cloud.wait_for("ready");
    let robot = system.start_agent(
        &deployment,
        "robot",
        &(pipeline(&system, "first") + &pipeline(&system, "second")),
    );
    let runs = api.wait_until("/api/v1/runs", |runs| {
        let runs = runs["runs"].as_array()?;
        let finished_runs: Vec<_> = runs.iter().filter(|run| run["reason"] == "finished").cloned().collect();
        (finished_runs.len() == 2).then_some(finished_runs)
    });
    let count =
        |run: &Value, name: &str| run["counts"][name].as_u64().unwrap_or_else(|| panic!("no {name}: {run}"));
    for run in &runs {
        assert_eq!(count(run, "ok") + count(run, "lost"), ITERATIONS, "{run}");
    }
    let lost: u64 = runs.iter().map(|run| count(run, "lost")).sum();
    assert!(lost > 0 && cloud.logs_before_end("no memory for a frame of"), "{}", cloud.log());
    assert!(robot.logs_before_end("the run continues after a reconnect"), "{}", robot.log());
    assert_eq!(robot.stop().code(), 0);
    assert_eq!(cloud.stop().code(), 0);
}
