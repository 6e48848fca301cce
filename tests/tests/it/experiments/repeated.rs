//! Tests that `run.json` contains everything that is needed to repeat a run.

use std::fs;
use std::path::Path;

use peernet_tests::{ProcessEnd, program, root};
use serde_json::{Map, Value};

use super::{Lab, Results, column, json};

/// Experiment with pictures in shuffled order. Their encoded sizes differ, so the sizes that were
/// sent show the order.
const SHUFFLED: &str = r#"
[experiment]
name = "shuffled"
seed = 9
iterations = 12
warm_up = { iterations = 2 }

[network]
config = "net_config.yaml"

[pipeline]
sensor = { kind = "images", path = "{root}/models/quality-control/pictures", order = "shuffled" }
transforms = [{ kind = "resize", width = 96, height = 64 }, { kind = "encode", format = "jpeg", quality = 80 }]
placement = { kind = "remote", peer = "cluster", model = "echo" }
"#;

/// Keys of a run's pipeline that belong to `[experiment]`, and keys that `peernet run` fills in.
const EXPERIMENT_KEYS: [&str; 6] = ["name", "limit", "warm_up", "episode_steps", "start", "experiment"];

impl Lab {
    /// Runs `peernet run` in the lab's folder, with a folder there for the results.
    fn run_in_folder(&self, file: &str, results: &str) -> ProcessEnd {
        let arguments = ["run", file, "--result-loc", results];
        let environment = [("OMP_NUM_THREADS", "3"), ("PEERNET_SECRET", "not to be recorded")];
        self.network
            .edge()
            .start(&program("peernet"), &arguments, self.deployment.folder(), &environment)
            .wait_for_end()
    }
}

/// Returns the experiment of a run, from its record alone, as docs/results.md describes.
fn experiment_file_from_record(record: &Value) -> String {
    let pipeline = record["pipeline"].as_object().expect("a table");
    let mut experiment = Map::from_iter([("name".to_owned(), "again".into())]);
    experiment.extend(pipeline["limit"].as_object().expect("a table").clone());
    for key in ["warm_up", "episode_steps"] {
        experiment.extend(pipeline.get(key).map(|value| (key.to_owned(), value.clone())));
    }
    let pipeline = pipeline.iter().filter(|(key, _)| !EXPERIMENT_KEYS.contains(&key.as_str()));
    let mut file = record["agent"].as_object().expect("tables").clone();
    file.insert("experiment".to_owned(), experiment.into());
    file.insert("pipeline".to_owned(), pipeline.map(|(key, value)| (key.clone(), value.clone())).collect());
    toml::to_string(&file).expect("the record leaves out unknown values, so it has no null")
}

/// Returns the record without the values that differ in each run.
fn without_varying_values(record: &Value) -> Value {
    let mut pipeline = record["pipeline"].clone();
    for key in ["name", "experiment"] {
        pipeline.as_object_mut().expect("a table").remove(key);
    }
    let keys = ["agent", "facts", "seeds", "warm_up", "model", "placement", "environment", "patience_s"];
    let values = keys.iter().map(|key| ((*key).to_owned(), record[*key].clone()));
    values.chain([("pipeline".to_owned(), pipeline)]).collect()
}

#[test]
fn run_is_repeated_from_its_record() {
    let lab = Lab::new();
    let folder = lab.deployment.folder();
    let write = |name: &str, text: &str| fs::write(folder.join(name), text).expect("writable");
    let devices = format!("devices:\n  cluster: {}\nserver: cluster\n", lab.network.cloud().address);
    write("net_config.yaml", &devices);
    write("first.toml", &SHUFFLED.replace("{root}", &root().display().to_string()));
    let assert_finished = |end: ProcessEnd| {
        assert_eq!(end.code(), 0, "{}", end.log);
        end.log
    };
    let read_single_run = |results: &str| {
        let results = Results::of(folder.join(results));
        let [run] = results.folders().try_into().expect("one run");
        let file = |name: &str| results.file(&run, name);
        (json(&file("run.json")), column(&file("data.csv"), "upload-bytes"))
    };
    assert_finished(lab.run_in_folder("first.toml", "first"));
    let (record, sizes) = read_single_run("first");
    assert!(sizes.len() == 14 && sizes.iter().any(|size| *size != sizes[0]), "{sizes:?}");
    assert_eq!(record["network_config"]["file"], "net_config.yaml");
    assert_eq!(record["network_config"]["text"], devices.as_str());
    assert_eq!(record["environment"]["OMP_NUM_THREADS"], "3");
    assert!(!record.to_string().contains("not to be recorded"));
    assert_eq!(record["folder"].as_str().map(Path::new), folder.canonicalize().ok().as_deref());

    // Another device does not matter for the measured run, but the file has changed.
    write("net_config.yaml", &devices.replace("server:", "  spare: 10.0.0.99\nserver:"));
    let log = assert_finished(lab.run_in_folder("first.toml", "first"));
    assert!(log.contains("net_config.yaml has changed since some runs were measured"), "{log}");
    assert_eq!(read_single_run("first").0, record, "the record was not changed");

    fs::remove_file(folder.join("net_config.yaml")).expect("removable");
    write("again.toml", &experiment_file_from_record(&record));
    assert_finished(lab.run_in_folder("again.toml", "again"));
    let (other, other_sizes) = read_single_run("again");
    assert_eq!(without_varying_values(&other), without_varying_values(&record));
    assert_eq!(other_sizes, sizes, "the same pictures in the same order");
}
