//! Test of a Python sensor and a Python model over a network, up to the store.

use peernet_tests::{Network, TwoHostTestbed};

use super::{model_table, pipeline_table, write_modules};

#[test]
fn python_objects_exchange_arrays_and_record_stages() {
    let testbed = TwoHostTestbed::new(|_| Network::direct());
    write_modules(testbed.folder());
    let cloud = testbed.start_cloud(&model_table());
    let placement = format!("{{ kind = \"remote\", peer = \"{}\", model = \"follower\" }}", testbed.peer());
    let keys = "limit = { iterations = 30 }\nactuator = { kind = \"log\" }\n";
    let edge = testbed.start_edge(&(pipeline_table(&placement) + keys), &[]);
    edge.wait_for("the rig is up");
    let api = &testbed.api;
    let run = api.wait_for_finished_run();

    // Every tenth sample failed with the message of the custom code; the others succeeded.
    let detail = api.json(&format!("/api/v1/runs/{run}"));
    assert_eq!(detail["counts"]["failed"], 3, "{detail}");
    assert_eq!(detail["counts"]["ok"], 27, "{detail}");
    let facts = detail["facts"].to_string();
    for fact in ["class rig::Rig", "class follower::Follower", "Python 3."] {
        assert!(facts.contains(fact), "{fact} is missing in {facts}");
    }
    let failed = api.json(&format!("/api/v1/runs/{run}/iterations/10"));
    let text = failed["outcome"].to_string() + &failed["reason"].to_string();
    assert!(text.contains("the path is lost at 10") && text.contains("follower.py"), "{failed}");

    // The time between the processes is a stage, and the stages add up to the total.
    let edge_stages = ["sensing", "encode", "upload", "download", "actuation"];
    let cloud_stages = ["queue", "ipc", "preprocessing", "inference", "postprocessing"];
    api.assert_stages_sum_to_total(run, &[&edge_stages[..], &cloud_stages].concat());
    assert!(api.mean(run, "capture-ipc") <= api.mean(run, "capture"));

    cloud.wait_for("following on cuda:0");
    assert_eq!(edge.stop().code(), 0);
    assert_eq!(cloud.stop().code(), 0);
    testbed.stop();
}
