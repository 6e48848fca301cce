//! The experiment with a language model, with its scripted server on both machines, and the figure of length against
//! latency.

use std::path::Path;

use peernet_tests::{Document, DocumentedCommands, ProcessEnd};

use crate::experiments::{Results, column};

pub(crate) const COMMANDS: [&str; 6] = [SERVER, CLOUD, ONE_RUN, ALL_RUNS, PLOT, TWO_MACHINES];

const SERVER: &str = "python3 configs/language-models/scripted_server.py";
const CLOUD: &str = "peernetd run configs/language-model-cloud.toml";
const ONE_RUN: &str = "peernet run --only Where=edge --only Input=picture configs/experiments/llm.toml";
const ALL_RUNS: &str = "peernet run configs/experiments/llm.toml";
const PLOT: &str = "peernet plot --kind length results/llm";
const TWO_MACHINES: &str =
    "peernet run --set pipeline.placement.peer=tcp://10.0.0.2:5551 configs/experiments/llm.toml";

const ITERATIONS: usize = 10;
/// Options of the scripted server that make it faster than in the document.
const SERVER_OPTIONS: &str = "scripted_server.py --prefill-ms 2 --picture-ms 20 --token-ms 0.2";
/// Times of the script with these options, seconds.
const PREFILL: f64 = 0.002;
const PICTURE: f64 = 0.020;
const TOKEN: f64 = 0.0002;
/// Input tokens that the script counts for a picture.
const PICTURE_TOKENS: f64 = 576.0;

fn assert_success(end: &ProcessEnd) {
    assert_eq!(end.code(), 0, "{}", end.log);
}

/// Returns a column of the iterations that are not warm-up.
fn column_without_warm_up(data: &Path, name: &str) -> Vec<f64> {
    let is_warm_up = column(data, "warm-up");
    let values = column(data, name).into_iter().zip(is_warm_up).filter(|(_, is_warm_up)| is_warm_up == "0");
    values.map(|(value, _)| value.parse().unwrap_or(f64::NAN)).collect()
}

/// Checks the iterations of a run against the script.
fn check_run(results: &Results, folder: &str) {
    let data = results.file(folder, "data.csv");
    let (is_remote, has_picture) = (folder.contains("cloud"), folder.contains("picture"));
    let node = |name: &str| column_without_warm_up(&data, &format!("inference_{name}"));
    let lengths = node("output-tokens");
    assert_eq!(lengths.len(), ITERATIONS, "{folder}");
    let first_token = PREFILL + if has_picture { PICTURE } else { 0.0 };
    // The script never sends a token early, so its times are lower bounds on any machine.
    let inference = column_without_warm_up(&data, "inference");
    for (time, tokens) in inference.iter().zip(&lengths) {
        assert!(*time >= first_token + (tokens - 1.0) * TOKEN, "{folder}: {tokens} tokens in {time} s");
    }
    assert!(node("time-to-first-token").iter().all(|time| *time >= first_token), "{folder}");
    assert!(node("finish-reason-stop").iter().all(|stopped| *stopped == 1.0), "{folder}");
    // A missing number is NaN, which is not greater than 0.
    let is_possible = |tokens: &f64| *tokens > 0.0 && (*tokens > PICTURE_TOKENS) == has_picture;
    assert!(node("input-tokens").iter().all(is_possible), "{folder}");
    let uploads = column_without_warm_up(&data, "upload");
    assert!(uploads.iter().all(|time| time.is_nan() != is_remote), "{folder}: {uploads:?}");
    if is_remote {
        // Each token crossed the network as a partial answer.
        assert_eq!(column_without_warm_up(&data, "parts"), lengths, "{folder}");
        let first_parts = column_without_warm_up(&data, "first-part");
        assert!(
            first_parts
                .iter()
                .zip(column_without_warm_up(&data, "total"))
                .all(|(first, total)| *first <= total)
        );
    }
}

#[test]
fn language_model_answers_on_edge_and_cloud() {
    let machines = DocumentedCommands::new(&COMMANDS);
    let script = "configs/language-models/scripted_server.py";
    machines.write(script, &Document::read(script).text);
    machines.copy("configs/language-model-cloud.toml", &[("tcp://127.0.0.1:5551", "tcp://0.0.0.0:5551")]);
    let iterations = format!("iterations = {ITERATIONS}");
    machines.copy("configs/experiments/llm.toml", &[("iterations = 100", &iterations)]);
    let options = [("scripted_server.py", SERVER_OPTIONS)];
    let servers = [machines.on_edge(SERVER, &options), machines.on_cloud(SERVER, &options)];
    servers.iter().for_each(|server| drop(server.wait_for("http://127.0.0.1:8080/v1")));

    // The paper's own measurement needs no cloud.
    assert_success(&machines.on_edge(ONE_RUN, &[]).wait_for_end());
    let results = Results::of(machines.folder().join("results/llm"));
    assert_eq!(results.states().iter().filter(|state| *state == "finished").count(), 1);

    let cloud = machines.on_cloud(CLOUD, &[]);
    cloud.wait_for("ready");
    assert_success(&machines.on_edge(ALL_RUNS, &[]).wait_for_end());
    assert_eq!(results.states(), ["finished"; 4]);
    let mut lengths = Vec::new();
    for folder in results.folders() {
        check_run(&results, &folder);
        lengths.extend(column_without_warm_up(&results.file(&folder, "data.csv"), "inference_output-tokens"));
    }
    // An answer of the script has about 60 tokens or about 240, with the same probability.
    assert!(lengths.iter().any(|tokens| *tokens < 120.0), "no answer is short: {lengths:?}");
    assert!(lengths.iter().any(|tokens| *tokens > 150.0), "no answer is long: {lengths:?}");

    assert_success(&machines.on_edge(PLOT, &[]).wait_for_end());
    for folder in results.folders() {
        assert!(
            results.file(&folder, "length.svg").is_file(),
            "{folder} has no figure, although its answers differ in length"
        );
    }

    let two_machines = [("run --set", "run --result-loc results/two --only Where=cloud --set")];
    assert_success(&machines.on_edge(TWO_MACHINES, &two_machines).wait_for_end());
    let two = Results::of(machines.folder().join("results/two"));
    assert_eq!(two.states().iter().filter(|state| *state == "finished").count(), 2);

    let [edge_server, cloud_server] = servers;
    for process in [cloud, edge_server, cloud_server] {
        assert_success(&process.stop());
    }
    machines.finish();
}
