//! Test that the seed determines the order and the payloads, regardless of other traffic.

use peernet_tests::{Api, DocumentedCommands};

use super::{Results, column, wait_for_runs};

/// Documented commands that this test executes.
pub(crate) const COMMANDS: [&str; 3] = [
    "peernetd run configs/aggregator.toml",
    "peernetd run configs/cloud.toml",
    "peernet run configs/experiments/demo.toml",
];

/// Returns the order of the runs; and, for each run that sends its pictures to the cloud unchanged, their sizes. These runs are sorted by
/// configuration and repeat.
fn run_order_and_sizes(results: &Results) -> (Vec<String>, Vec<Vec<String>>) {
    let mut folders = results.folders();
    let order = folders.clone();
    // The name of a folder is the number of the run, the labels of its configuration and its repeat, such as `004-cloud-no-r1`. The label
    // `no` means that pictures are not resized.
    folders.retain(|folder| folder.contains("-no-") && !folder.contains("local"));
    folders.sort_by_key(|folder| folder[3..].to_owned());
    let sizes = folders.iter().map(|folder| column(&results.file(folder, "data.csv"), "upload-bytes"));
    (order, sizes.collect())
}

/// Waits until all stored runs of an experiment are finished, and returns their number.
fn wait_for_stored_runs(machines: &DocumentedCommands, experiment: &str) -> usize {
    let experiment = experiment.to_owned();
    machines.cloud().run_in_namespace(move || {
        Api::on_port(8040).wait_until("/api/v1/runs?limit=100", |runs| {
            let runs = runs["runs"].as_array()?;
            let experiment_runs = runs.iter().filter(|run| run["experiment"]["id"] == *experiment);
            experiment_runs.clone().all(|run| run["reason"] == "finished").then(|| experiment_runs.count())
        })
    })
}

#[test]
fn demo_with_same_seed_repeats_order_and_payloads() {
    let machines = DocumentedCommands::new(&COMMANDS);
    machines.copy("configs/aggregator.toml", &[("127.0.0.1:5550", "0.0.0.0:5550")]);
    machines.copy("configs/cloud.toml", &[("tcp://127.0.0.1:5551", "tcp://0.0.0.0:5551")]);
    // Fewer and shorter episodes, streamed to the dashboard.
    machines.copy(
        "configs/experiments/demo.toml",
        &[
            ("episodes = 4", "episodes = 2"),
            ("episode_steps = 25", "episode_steps = 6"),
            ("[experiment]", "[experiment]\naggregator = \"tcp://10.0.0.2:5550\""),
        ],
    );
    let aggregator = machines.on_cloud("peernetd run configs/aggregator.toml", &[]);
    let cloud = machines.on_cloud("peernetd run configs/cloud.toml", &[]);
    cloud.wait_for("ready");
    let results = Results::of(machines.folder().join("results/demo"));
    let measure = |options: &str| {
        let options = format!("demo.toml {options}");
        let command = "peernet run configs/experiments/demo.toml";
        let end = wait_for_runs(machines.on_edge(command, &[("demo.toml", &options)]), 10);
        assert_eq!(end.code(), 0, "{}", end.log);
        (run_order_and_sizes(&results), end.log)
    };

    let ((order, sizes), log) = measure("");
    assert_eq!((order.len(), sizes.len()), (10, 4), "{order:?}");
    assert!(log.contains("total (measured)") && log.contains("10 of 10 runs finished"), "{log}");
    // The order is: cloud in repeats 1 and 2, then echo in repeats 1 and 2. Both configurations get
    // the same pictures in the same repeat, and other pictures in the other repeat.
    assert_eq!((&sizes[0], &sizes[1]), (&sizes[2], &sizes[3]));
    assert_ne!(sizes[0], sizes[1]);
    for name in ["compare.txt", "compare.md", "compare.csv", "compare.tex", "stacked.png", "stacked.svg"] {
        assert!(results.folder.join(name).is_file(), "{name}");
    }
    let places = column(&results.folder.join("compare.csv"), "Where");
    assert_eq!(places, ["local", "cloud", "cloud", "echo", "echo"], "in the order of the file");
    let counts = column(&results.folder.join("compare.csv"), "count");
    // Each of the two repeats has two episodes of six steps. The first episode and the first step of
    // the second episode are warm-up, so five steps of each repeat count.
    assert!(counts.iter().all(|count| count == "10"), "{counts:?}");
    let id = results.record()["id"].as_str().expect("an experiment has an id").to_owned();
    assert_eq!(wait_for_stored_runs(&machines, &id), 10);

    let repeated = measure("--restart").0;
    assert_eq!(repeated, (order.clone(), sizes.clone()));
    let (other_order, other_sizes) = measure("--restart --seed 2").0;
    assert_ne!(other_order, order);
    assert_ne!(other_sizes, sizes);
    for process in [cloud, aggregator] {
        let end = process.stop();
        assert_eq!(end.code(), 0, "{}", end.log);
    }
    machines.finish();
}
