//! Tests of the paper's two commands between two machines.

use peernet_tests::LoopbackDeployment;
use serde_json::{Value, json};

use super::{Lab, PUBLISHED_COLUMNS, picture};
use crate::models::exported_models;

const FILES: [&str; 5] = ["data.csv", "run.json", "summary.md", "summary.csv", "summary.tex"];

/// Figures that the paper's program draws.
const FIGURES: [&str; 6] = [
    "sensing-time.png",
    "upload-time.png",
    "inference-time.png",
    "download-time.png",
    "upload-throughput.png",
    "download-throughput.png",
];

#[test]
fn published_commands_work_unchanged() {
    let lab = Lab::new();
    std::fs::copy(picture(), lab.folder().join("sample-image.JPEG")).expect("writable");
    let server = lab.start_server(
        "PEERNet --server --name cluster --network zmq-tcp --network-config net_config.yaml --model-name dummy \
         --device cuda:6 --iterations 12",
    );
    let client = lab.start_client(
        "PEERNet --client --name jetson-orin --network zmq-tcp --network-config net_config.yaml \
         --dataset-loc sample-image.JPEG --iterations 12 --result-loc results --generate-plots",
    );
    let (client, server) = (client.wait_for_end(), server.wait_for_end());
    assert_eq!((client.code(), server.code()), (0, 0), "{}\n{}", client.log, server.log);
    for log in [&client.log, &server.log] {
        // The warning that nothing is encrypted.
        assert_eq!(log.matches("plain mode").count(), 1, "{log}");
    }
    assert!(server.log.contains("all interfaces") && server.log.contains("12 answers"), "{}", server.log);
    assert!(client.log.contains("Total (sum of stages)"), "{}", client.log);

    let data = lab.data("results");
    assert_eq!(data.header[..PUBLISHED_COLUMNS.len()], PUBLISHED_COLUMNS);
    let numbers: Vec<f64> = (1..=12).map(f64::from).collect();
    assert_eq!(data.numbers("iteration"), numbers);
    assert_eq!((data.count_outcome("ok"), data.rows.len()), (12, 12));
    // The first five iterations are warm-up.
    let warm_up = data.column("warm-up");
    assert_eq!(warm_up.iter().position(|cell| *cell == "0"), Some(5), "{warm_up:?}");
    // Decoded pixels of three bytes each: the size of the pickled picture without the pickle's overhead.
    let picture_bytes = f64::from(1280 * 960 * 3);
    assert!(data.numbers("upload-bytes").iter().all(|bytes| *bytes == picture_bytes));
    for (stage, min_seconds) in [("preprocessing", 0.01), ("inference", 0.08), ("postprocessing", 0.01)] {
        assert!(data.numbers(stage).iter().all(|seconds| *seconds >= min_seconds), "{stage}");
    }
    let (upload, low, high) = (data.numbers("upload"), data.numbers("upload-lo"), data.numbers("upload-hi"));
    assert!(upload.iter().zip(low).zip(high).all(|((value, low), high)| low <= *value && *value <= high));

    let record = lab.record("results");
    assert_eq!(record["reason"], "finished");
    assert_eq!(
        (&record["edge"]["name"], &record["cloud"]["name"]),
        (&"jetson-orin".into(), &"cluster".into())
    );
    assert_eq!(
        (&record["pipeline"]["name"], &record["name"]),
        (&"jetson-orin".into(), &"jetson-orin".into())
    );
    let cloud = &record["cloud"];
    assert_eq!(cloud["hardware"], record["edge"]["hardware"], "both are this machine: {record:#}");
    assert_eq!((&cloud["version"], &record["edge"]["version"]), (&record["version"], &record["version"]));
    assert!(record["version"].as_str().is_some_and(|version| version.contains(" (")), "{record:#}");
    assert_eq!(record["model"]["name"], "dummy");
    assert_eq!(record["counts"]["ok"], 7);
    assert!(
        record["command"].as_str().is_some_and(|command| command.contains("--dataset-loc sample-image.JPEG"))
    );
    assert!(record["pipeline"].is_object() && record["edge"]["hardware"].is_object(), "{record:#}");
    // The record contains the folder that relative paths begin at, the text of the file of devices, and the size of the
    // data set.
    let folder = lab.folder().canonicalize().expect("is there");
    assert_eq!(record["folder"], folder.display().to_string());
    let network = &record["network_config"];
    let text = std::fs::read_to_string(folder.join("net_config.yaml")).expect("is there");
    assert_eq!((&network["file"], &network["text"]), (&"net_config.yaml".into(), &text.into()));
    assert!(
        ["edge", "cloud"]
            .iter()
            .all(|host| record[host]["clock"].as_str().is_some_and(|text| !text.is_empty())),
        "{record:#}"
    );
    // Both hosts share one free-running clock, and the wall clock is read up to 3 µs after it. The
    // programs are in two network namespaces and cannot know that they share the clock, so they
    // measure the offset.
    for key in ["first_offset", "last_offset"] {
        let offset = &record["clocks"]["upload"][key];
        let bounds = offset["lo"].as_f64().zip(offset["hi"].as_f64());
        assert!(
            bounds.is_some_and(|(lo, hi)| lo < 3e-6 && -3e-6 < hi),
            "the offset of one clock is not zero: {record:#}"
        );
    }
    let facts = record["facts"].as_array().expect("pairs");
    let data_set = facts.iter().find(|fact| fact[0] == "Data set").map(|fact| &fact[1]);
    assert!(
        data_set.and_then(Value::as_str).is_some_and(|value| value.starts_with("1 file, ")),
        "{record:#}"
    );
    assert!(record["trust"].is_object(), "{record:#}");
    let results = lab.folder().join("results");
    assert!(FILES.iter().chain(&FIGURES).all(|name| results.join(name).is_file()), "{}", client.log);
    for name in FIGURES {
        let figure = image::open(results.join(name)).expect("a picture");
        assert!(figure.width() >= 500 && figure.height() >= 300, "{name}");
    }
}

#[test]
fn published_network_measurement_works_with_random_weights() {
    let lab = Lab::new();
    let models = exported_models().display();
    let server = lab.start_server(&format!(
        "PEERNet --server --name cluster --network-config net_config.yaml --model-name efficientnet_v2_s \
         --models-dir {models} --device cpu --iterations 50"
    ));
    server.wait_for("serving efficientnet_v2_s");
    let client = lab.start_client(&format!(
        "PEERNet --client --name jetson-orin --network-config net_config.yaml --dataset-loc {} --iterations 50 \
         --result-loc results",
        picture().display()
    ));
    let (client, server) = (client.wait_for_end(), server.wait_for_end());
    assert_eq!((client.code(), server.code()), (0, 0), "{}\n{}", client.log, server.log);
    let data = lab.data("results");
    assert_eq!((data.count_outcome("ok"), data.rows.len()), (50, 50));
    assert_eq!(data.header[..PUBLISHED_COLUMNS.len()], PUBLISHED_COLUMNS);
    let record = lab.record("results");
    assert_eq!(
        (&record["model"]["name"], &record["model"]["device"]),
        (&"efficientnet_v2_s".into(), &"cpu".into())
    );
    assert_eq!(record["model"]["sha256"].as_str().map(str::len), Some(64), "{record:#}");
}

#[test]
fn client_started_before_server_sends_every_sample_kind() {
    for (options, bytes) in [
        ("--sensor-type \"random string\" --text-size 300", Some(300.0)),
        ("--sensor-type synthetic --text-size 4000", Some(4000.0)),
        ("--dataset-loc sample-image.JPEG --encoding jpeg:50", None),
        (
            "--dataset-loc sample-image.JPEG --encoding file",
            Some(std::fs::metadata(picture()).expect("is there").len() as f64),
        ),
    ] {
        let lab = Lab::on_one_machine();
        std::fs::copy(picture(), lab.folder().join("sample-image.JPEG")).expect("writable");
        let client = lab.start_client(&format!(
            "PEERNet --client --name jetson-orin --network-config net_config.yaml --iterations 20 {options}"
        ));
        client.wait_for("is away");
        let server = lab.start_server(
            "PEERNet --name cluster --network-config net_config.yaml --model-name echo --iterations 20",
        );
        let (client, server) = (client.wait_for_end(), server.wait_for_end());
        assert_eq!((client.code(), server.code()), (0, 0), "{}\n{}", client.log, server.log);
        let data = lab.data("results");
        assert_eq!(data.count_outcome("ok"), 20, "{options}");
        if let Some(bytes) = bytes {
            assert!(data.numbers("upload-bytes").iter().all(|sent| *sent == bytes), "{options}");
        }
    }
}

#[test]
fn streamed_run_is_on_dashboard_with_same_host() {
    let lab = Lab::on_one_machine();
    let deployment = LoopbackDeployment::new();
    let (_aggregator, api) = deployment.start_aggregator();
    for results in ["first", "second"] {
        let server = lab.start_server(
            "PEERNet --server --name cluster --network-config net_config.yaml --model-name echo --iterations 20",
        );
        let client = lab.start_client(&format!(
            "PEERNet --client --name jetson-orin --network-config net_config.yaml --sensor-type synthetic \
             --iterations 20 --result-loc {results} --aggregator tcp://127.0.0.1:{}",
            deployment.events_port
        ));
        let (client, server) = (client.wait_for_end(), server.wait_for_end());
        assert_eq!((client.code(), server.code()), (0, 0), "{}\n{}", client.log, server.log);
        let message = "see host jetson-orin, pipeline jetson-orin, on the dashboard of the aggregator at 127.0.0.1 \
                    (usually http://127.0.0.1:8040)";
        assert!(client.log.contains(message), "{}", client.log);
    }
    let runs = api.wait_until("/api/v1/runs", |runs| {
        let runs = runs["runs"].as_array()?.clone();
        (runs.len() == 2 && runs.iter().all(|run| run["ended"].is_string())).then_some(runs)
    });
    assert!(runs.iter().all(|run| run["host"] == "jetson-orin"), "{runs:#?}");
    // Afterwards the dashboard shows a finished run and a host without problems.
    let state = api.wait_until("/api/v1/pipelines/jetson-orin/jetson-orin", |pipeline| {
        let has_ended = ["finished", "failed", "away"].contains(&pipeline["state"].as_str()?);
        has_ended.then(|| pipeline["state"].clone())
    });
    assert_eq!(state, "finished");
    let waiting = api.wait_until("/api/v1/hosts/jetson-orin", |host| {
        (host["connected"] == false).then(|| host["now"]["events"]["waiting"].clone())
    });
    assert_eq!(waiting, 0);
    let ids = ["first", "second"].map(|results| lab.record(results)["edge"]["id"].clone());
    assert!(ids[0].is_string() && ids[0] == ids[1], "{ids:?}");
}

#[test]
fn existing_results_are_replaced_only_on_request() {
    let lab = Lab::on_one_machine();
    let measure = |iterations: u32, options: &str| {
        let server = lab.start_server(&format!(
            "PEERNet --server --name cluster --network-config net_config.yaml --model-name echo --iterations {iterations}"
        ));
        let client = lab.start_client(&format!(
            "PEERNet --client --name jetson-orin --network-config net_config.yaml --sensor-type synthetic \
             --iterations {iterations} {options}"
        ));
        let (client, server) = (client.wait_for_end(), server.wait_for_end());
        assert_eq!((client.code(), server.code()), (0, 0), "{}\n{}", client.log, server.log);
    };
    measure(6, "");
    measure(7, "");
    assert_eq!((lab.data("results").rows.len(), lab.data("results/run-2").rows.len()), (6, 7));
    measure(8, "--result-loc results --overwrite");
    assert_eq!((lab.data("results").rows.len(), lab.data("results/run-2").rows.len()), (8, 7));
}

#[test]
fn clock_settings_come_from_configuration() {
    let lab = Lab::on_one_machine();
    std::fs::write(lab.folder().join("edge.toml"), "[agent]\n[clock_fault]\noffset_ms = 5000\n")
        .expect("writable");
    let server = lab.start_server(
        "PEERNet --server --name cluster --network-config net_config.yaml --model-name dummy --iterations 20",
    );
    let client = lab.start_client(
        "PEERNet --client --name jetson-orin --network-config net_config.yaml --sensor-type synthetic \
         --iterations 20 --result-loc results --config edge.toml",
    );
    let (client, server) = (client.wait_for_end(), server.wait_for_end());
    assert_eq!((client.code(), server.code()), (0, 0), "{}\n{}", client.log, server.log);
    assert!(client.log.contains("CLOCK FAULT INJECTION"), "{}", client.log);
    let data = lab.data("results");
    // The raw stamps differ by five seconds, but the reported delay is right.
    assert!(data.numbers("upload-raw").iter().all(|raw| *raw < -4.0));
    let delays = data.column("upload").into_iter().filter_map(|cell| cell.parse::<f64>().ok());
    let delays: Vec<f64> = delays.collect();
    assert!(!delays.is_empty() && delays.iter().all(|delay| (0.0..4.0).contains(delay)), "{delays:?}");
}

#[test]
fn measure_command_executes_run_request_of_file() {
    let lab = Lab::on_one_machine();
    let run_request = json!({
        "agent": {
            "model": [{ "kind": "echo", "name": "echo" }],
            "pipeline": [{
                "name": "on-board",
                "sensor": { "kind": "synthetic", "size_bytes": 100 },
                "placement": { "kind": "local", "model": "echo" },
                "load": { "mode": "rate", "hz": 50.0 },
                "limit": { "total": 40 },
            }],
        },
        "title": "an echo on board",
        "folder": lab.folder().join("ordered"),
        "overwrite": "refuse",
        "command": "peernet run echo.toml",
        "warm_up": "the first 5 iterations",
    });
    std::fs::write(lab.folder().join("order.json"), run_request.to_string()).expect("writable");
    let end = lab.start_client("PEERNet measure --order order.json").wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    let progress: Vec<Value> = end.log.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
    assert!(progress.iter().all(|progress| progress["of"] == 40), "{}", end.log);
    assert_eq!(progress.last().map(|progress| &progress["phase"]), Some(&"writing".into()), "{}", end.log);
    let (data, record) = (lab.data("ordered"), lab.record("ordered"));
    assert_eq!((data.rows.len(), data.count_outcome("ok")), (40, 40));
    assert_eq!((&record["title"], &record["cloud"]), (&"an echo on board".into(), &Value::Null));
    assert_eq!((&record["placement"]["kind"], &record["seeds"]["sensor"]), (&"local".into(), &1.into()));

    let second = lab.start_client("PEERNet measure --order order.json").wait_for_end();
    assert_eq!(second.code(), 64, "{}", second.log);
    assert_eq!(lab.start_client("PEERNet measure --order nothing.json").wait_for_end().code(), 66);
    std::fs::write(lab.folder().join("order.json"), "{}").expect("writable");
    assert_eq!(lab.start_client("PEERNet measure --order order.json").wait_for_end().code(), 78);
}
