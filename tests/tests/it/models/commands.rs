//! Tests of the commands `peernet models …`.

use std::process::{Command, Output};

use peernet_tests::{onnxruntime, program, root};
use serde_json::Value;

use super::{NAME, exported_model};

/// Runs `peernet models` in the root of the checkout, where `models/` is.
fn run_models_command(arguments: &[&str]) -> Output {
    let mut command = Command::new(program("peernet"));
    command
        .current_dir(root())
        .env("ORT_DYLIB_PATH", onnxruntime())
        .env("PEERNET_MODELS", &exported_model().models);
    command.arg("models").args(arguments).output().expect("can be started")
}

fn stdout_of_success(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout.clone()).expect("is text")
}

fn json(output: &Output) -> Value {
    serde_json::from_str(&stdout_of_success(output)).expect("is JSON")
}

#[test]
fn models_of_all_folders_are_listed() {
    let table = stdout_of_success(&run_models_command(&["list"]));
    let line_of = |name: &str| {
        table.lines().find(|line| line.starts_with(name)).unwrap_or_else(|| panic!("{table}")).to_owned()
    };
    assert!(line_of(NAME).contains("classification") && line_of(NAME).contains("random-3"), "{table}");
    assert!(line_of("quality-control").contains("models/quality-control"), "{table}");
    let models = json(&run_models_command(&["list", "--json"]));
    let names: Vec<&str> =
        models.as_array().expect("a list").iter().filter_map(|model| model["model"].as_str()).collect();
    assert_eq!(names[0], NAME, "the folder of the variable comes before models/");
}

#[test]
fn model_list_shows_hash_of_file() {
    let file = root().join("models/quality-control/model.onnx");
    let checksum = Command::new("sha256sum").arg(file).output().expect("is installed");
    let checksum = String::from_utf8(checksum.stdout).expect("is text");
    let hash = checksum.split_whitespace().next().expect("a hash");
    assert!(stdout_of_success(&run_models_command(&["show", "quality-control"])).contains(hash));
    let model = json(&run_models_command(&["show", "models/quality-control", "--json"]));
    assert_eq!((model["sha256"].as_str(), model["card"]["version"].as_str()), (Some(hash), Some("1")));
}

#[test]
fn check_uses_pictures_of_model_or_zeros() {
    let output = stdout_of_success(&run_models_command(&["check", "quality-control"]));
    assert!(output.contains("run on zeros") && output.contains("of 30 labels right"), "{output}");
    let output = stdout_of_success(&run_models_command(&["check", "defect-detector"]));
    assert!(output.contains("objects found, mAP@0.5 ") && output.contains(" %, mean IoU "), "{output}");
    let output = stdout_of_success(&run_models_command(&["check", NAME]));
    assert!(output.contains("no test pictures"), "{output}");
}

#[test]
fn bench_prints_each_stage_of_a_model() {
    let measurement = json(&run_models_command(&[
        "bench",
        "quality-control",
        "--iterations",
        "60",
        "--warm-up",
        "1",
        "--json",
        "--quiet",
    ]));
    for stage in ["preprocessing", "inference", "postprocessing", "all"] {
        let statistics = &measurement["seconds"][stage];
        assert_eq!(statistics["count"], 60, "{measurement}");
        let [p50, p95] = ["p50", "p95"].map(|key| statistics[key].as_f64().expect("enough samples"));
        assert!(p50 > 0.0 && p95 >= p50, "{statistics}");
        assert!(statistics["p99"].is_null(), "60 samples are too few for p99");
    }
    assert!(
        measurement["memory_bytes"]["with_model"].as_u64() > measurement["memory_bytes"]["before"].as_u64()
    );
}

#[test]
fn impossible_model_commands_fail_with_exit_code() {
    for (arguments, code, message) in [
        (
            &["show", "efficientnet_v2_xl"] as &[&str],
            66,
            "the folders contain defect-detector, efficientnet_v2_s, quality-control",
        ),
        (&["list", "--models-dir", "/nowhere"], 66, "there is no folder /nowhere"),
        (&["check", "quality-control", "--device", "gpu"], 64, "is not a device"),
        (&["check", "quality-control", "--device", "cuda:0"], 69, "CUDAExecutionProvider"),
        (&["check", "quality-control", "--pictures", "/nowhere.jpg"], 66, "/nowhere.jpg"),
        (&["bench", "quality-control", "--iterations", "0"], 64, "--iterations"),
    ] {
        let output = run_models_command(arguments);
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {error}");
        assert!(error.contains(message), "{arguments:?}: {error}");
    }
}

#[test]
fn exporting_script_names_missing_packages() {
    // Without site packages, as on a machine without torch.
    let script = root().join("models/export_torchvision.py");
    let output = Command::new(super::python()).arg("-S").arg(script).arg(NAME).output().expect("starts");
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success());
    assert!(error.contains("apt-get install python3-torch python3-torchvision python3-onnx"), "{error}");
}
