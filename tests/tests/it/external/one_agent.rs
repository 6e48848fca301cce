//! Test of a sensor without a model.

use peernet_tests::LoopbackDeployment;

const EDGE: &str = r#"
[[pipeline]]
name = "study"
sensor = { kind = "exec", command = ["{root}/docs/examples/external/light.sh"] }
placement = { kind = "none" }
limit = { total = 50 }
"#;

#[test]
fn run_without_model_is_shown_on_all_pages() {
    let deployment = LoopbackDeployment::new();
    let (_aggregator, api) = deployment.start_aggregator();
    let edge = deployment.start_agent("edge", EDGE);
    let run = api.wait_for_finished_run();

    let detail = api.json(&format!("/api/v1/runs/{run}"));
    // 5 of the 50 iterations are warm-up.
    assert_eq!(detail["counts"]["ok"].as_u64(), Some(45), "{detail}");
    assert_eq!(
        (&detail["placement"]["kind"], &detail["placement"]["model"]),
        (&"none".into(), &"none".into())
    );
    assert!(detail["placement"]["peer"].is_null(), "{detail}");
    // The live state arrives on a separate lane.
    let kind = api.wait_until("/api/v1/pipelines/edge/study", |pipeline| {
        pipeline["placement"]["kind"].as_str().map(str::to_owned)
    });
    assert_eq!(kind, "none");
    for name in ["sensing", "capture", "total"] {
        assert!(api.stage_statistics(run, name).is_some(), "{name} is missing");
    }
    assert_eq!(api.mean(run, "dropped-samples"), 0.0);
    for absent in ["inference", "upload", "top-1"] {
        assert!(api.stage_statistics(run, absent).is_none(), "{absent}");
    }
    for page in ["/", "/runs", "/pipelines", "/pipelines/edge/study", &format!("/runs/{run}"), "/hosts"] {
        let (status, text) = api.get(page).expect("the dashboard answers");
        assert_eq!(status, 200, "{page}");
        // The page of the hosts names no pipeline.
        assert!(
            text.contains("sensor alone") || page == "/hosts",
            "{page} does not say that the sensor is alone"
        );
        assert!(!text.contains("none on board"), "{page}");
    }
    assert_eq!(edge.stop().code(), 0);
}
