//! Tests of runs that are also streamed to aggregators: to several in turn, and to one that is absent.

use peernet_tests::LoopbackDeployment;
use serde_json::Value;

use super::Lab;

/// Measures and streams; returns the client's output.
fn measure_and_stream(lab: &Lab, deployment: &LoopbackDeployment) -> String {
    let server = lab.start_server(
        "PEERNet --server --name cluster --network-config net_config.yaml --model-name echo --iterations 20",
    );
    let client = lab.start_client(&format!(
        "PEERNet --client --name jetson-orin --network-config net_config.yaml --sensor-type synthetic \
         --iterations 20 --result-loc results --overwrite --aggregator tcp://127.0.0.1:{}",
        deployment.events_port
    ));
    let (client, server) = (client.wait_for_end(), server.wait_for_end());
    assert_eq!((client.code(), server.code()), (0, 0), "{}\n{}", client.log, server.log);
    client.log
}

#[test]
fn streams_are_stored_and_waiting_events_reported() {
    let lab = Lab::on_one_machine();
    let (first_deployment, absent_deployment) = (LoopbackDeployment::new(), LoopbackDeployment::new());
    let (_first_aggregator, first_api) = first_deployment.start_aggregator();
    let waiting_note = format!("wait for the aggregator at localhost:{}, in ", absent_deployment.events_port);
    let (link_text, later_text) =
        ("see host jetson-orin", "will be on the dashboard of the aggregator at 127.0.0.1:");
    let output = measure_and_stream(&lab, &first_deployment);
    assert!(
        output.contains(link_text) && !output.contains("wait for the aggregator"),
        "all events are stored: {output}"
    );
    for (deployment, title, expected, unexpected) in [
        (&absent_deployment, "the absent aggregator", later_text, link_text),
        (&first_deployment, "the first aggregator", link_text, later_text),
    ] {
        let output = measure_and_stream(&lab, deployment);
        assert!(output.contains(&waiting_note), "{title}: {output}");
        assert!(output.contains(expected) && !output.contains(unexpected), "{title}: {output}");
    }
    let (_second_aggregator, second_api) = absent_deployment.start_aggregator();
    let output = measure_and_stream(&lab, &absent_deployment);
    assert!(!output.contains(&waiting_note), "the waiting events are delivered: {output}");
    for api in [first_api, second_api] {
        let host = api.wait_until("/api/v1/hosts/jetson-orin", |host| {
            let is_delivered = host["connected"] == false && host["now"]["events"]["waiting"] == 0;
            is_delivered.then(|| host.clone())
        });
        assert_eq!(host["stored"]["gaps"], 0, "{host:#}");
        api.wait_until("/api/v1/runs", |runs| {
            let runs = runs["runs"].as_array()?;
            (runs.len() == 2 && runs.iter().all(|run| run["ended"].is_string())).then_some(())
        });
    }
}

#[test]
fn export_of_aggregator_equals_file_of_run() {
    let (lab, deployment) = (Lab::on_one_machine(), LoopbackDeployment::new());
    let (_aggregator, api) = deployment.start_aggregator();
    measure_and_stream(&lab, &deployment);
    let (status, text) = api
        .get(&format!("/api/v1/runs/{}/export", api.wait_for_finished_run()))
        .expect("the dashboard answers");
    assert_eq!(status, 200, "{text}");
    let written = std::fs::read_to_string(lab.folder().join("results/data.csv")).expect("written");
    let difference = text.lines().zip(written.lines()).find(|(export, file)| export != file);
    assert!(text == written, "{difference:#?}");

    std::fs::write(lab.folder().join("export.csv"), text).expect("writable");
    let comparison = lab.start_client("PEERNet compare results export.csv").wait_for_end();
    assert_eq!(comparison.code(), 0, "{}", comparison.log);
    assert!(comparison.log.contains("export"), "{}", comparison.log);
}

#[test]
fn dashboard_and_record_show_same_conditions() {
    let (lab, deployment) = (Lab::on_one_machine(), LoopbackDeployment::new());
    let (_aggregator, api) = deployment.start_aggregator();
    measure_and_stream(&lab, &deployment);
    let stored = api.json(&format!("/api/v1/runs/{}", api.wait_for_finished_run()));
    let record = lab.record("results");
    let conditions = |conditions: &Value| conditions.as_array().expect("a list").clone();
    let recorded = [&record["edge"], &record["cloud"]].map(|host| conditions(&host["conditions"])).concat();
    assert_eq!(conditions(&stored["conditions"]), recorded);
    for purpose in ["GiB for the spool", "GiB for the results"] {
        let names_purpose = |found: &str| found.ends_with(purpose);
        let has_disk =
            recorded.iter().any(|condition| condition["found"].as_str().is_some_and(names_purpose));
        assert!(has_disk, "{purpose}: {recorded:#?}");
    }
}

#[test]
fn second_concurrent_stream_of_device_is_refused() {
    let (lab, deployment) = (Lab::on_one_machine(), LoopbackDeployment::new());
    let (_aggregator, _) = deployment.start_aggregator();
    let command = format!(
        "PEERNet --client --name jetson-orin --network-config net_config.yaml --sensor-type synthetic \
         --iterations 20 --aggregator tcp://127.0.0.1:{}",
        deployment.events_port
    );
    let first = lab.start_client(&command);
    first.wait_for("is away");
    let second = lab.start_client(&command).wait_for_end();
    assert_eq!(second.code(), 69, "{}", second.log);
    assert!(second.log.contains("runs as the host whose id is in"), "{}", second.log);
    assert!(!second.log.contains("state_dir"), "the message suggests a key of an agent: {}", second.log);
    first.stop();
}

#[test]
fn experiment_prints_no_link_to_absent_dashboard() {
    let (lab, absent_deployment) = (Lab::on_one_machine(), LoopbackDeployment::new());
    let file = format!(
        "[experiment]\nname = \"board\"\niterations = 20\naggregator = \"tcp://127.0.0.1:{}\"\n\
         [pipeline]\nsensor = {{ kind = \"synthetic\", size_bytes = 100 }}\nplacement = {{ kind = \"local\", model = \"echo\" }}\n\
         [[model]]\nname = \"echo\"\nkind = \"echo\"\n",
        absent_deployment.events_port
    );
    std::fs::write(lab.folder().join("board.toml"), file).expect("writable");
    // The second case configures the path of the spool. This spool is outside the host's folder and is examined, too.
    for (options, spool) in
        [("--result-loc a", "spool-localhost:"), ("--result-loc b --set spool.file=mine", "mine;")]
    {
        let end = lab.start_client(&format!("PEERNet run board.toml {options}")).wait_for_end();
        assert_eq!(end.code(), 0, "{}", end.log);
        let later_text = format!(
            "the runs of experiment board will be on the dashboard of the aggregator at 127.0.0.1:{}",
            absent_deployment.events_port
        );
        assert!(end.log.contains(&later_text) && !end.log.contains("see the runs"), "{}", end.log);
        let names_spool =
            end.log.lines().any(|line| line.contains("events wait for") && line.contains(spool));
        assert!(names_spool, "{spool}: {}", end.log);
        assert!(end.log.contains("warning: the aggregator at tcp://127.0.0.1:"), "{}", end.log);
        // In the next case, no events of this case wait.
        std::fs::remove_dir_all(lab.folder().join("state")).expect("it was made");
    }
}

#[test]
fn same_command_delivers_events_that_wait() {
    let (lab, deployment) = (Lab::on_one_machine(), LoopbackDeployment::new());
    let address = format!("tcp://127.0.0.1:{}", deployment.events_port);
    let file = format!(
        "[experiment]\nname = \"late\"\niterations = 20\nusers = 2\naggregator = \"{address}\"\n\
         [pipeline]\nsensor = {{ kind = \"synthetic\", size_bytes = 100 }}\nplacement = {{ kind = \"local\", model = \"echo\" }}\n\
         [[model]]\nname = \"echo\"\nkind = \"echo\"\n"
    );
    std::fs::write(lab.folder().join("late.toml"), file).expect("writable");
    let run = || {
        let end = lab.start_client("PEERNet run late.toml").wait_for_end();
        assert_eq!(end.code(), 0, "{}", end.log);
        end.log
    };
    let waiting = format!(
        "events wait for the aggregator at {address}, on 2 hosts of this experiment; the same command"
    );
    let output = run();
    assert!(output.contains(&format!("warning: the aggregator at {address} cannot be reached")), "{output}");
    assert_eq!(output.matches(&waiting).count(), 1, "{output}");
    let output = run();
    assert!(
        output.contains("nothing to do") && output.contains(&waiting),
        "the aggregator is still absent: {output}"
    );

    let (_aggregator, api) = deployment.start_aggregator();
    let output = run();
    assert!(output.contains("nothing to do") && !output.contains("events wait"), "{output}");
    assert!(output.contains("see the runs of experiment late"), "{output}");
    api.wait_until("/api/v1/runs", |runs| {
        let runs = runs["runs"].as_array()?;
        (runs.len() == 2 && runs.iter().all(|run| run["ended"].is_string())).then_some(())
    });
    assert!(!run().contains("delivering"), "all events are delivered already");
}
