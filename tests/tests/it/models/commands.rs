//! Tests of the commands `peernet models …`.

use std::process::{Command, Output};

use image::{GrayImage, Luma, Rgb, RgbImage};
use peernet_statistics::number::share;
use peernet_tests::{LoopbackDeployment, Process, onnxruntime, program, root};
use serde_json::Value;

use super::{NAME, exported_model};
use crate::experiments::{Results, column};

/// Experiment that scores two pictures.
const MASKS: &str = "
[experiment]
name = 'masks'
iterations = 2
warm_up = { iterations = 0 }
plots = false

[pipeline]
sensor = { kind = 'images', path = '{folder}/pictures' }
placement = { kind = 'local', model = 'segmentation' }

[[model]]
name = 'segmentation'
kind = 'onnx'
path = '{folder}/models/segmentation'
";

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
    // `reference.py` exports the model with random weights from seed 3.
    assert!(line_of(NAME).contains("classification") && line_of(NAME).contains("random-3"), "{table}");
    assert!(line_of("quality-control").contains("models/quality-control"), "{table}");
    let models = json(&run_models_command(&["list", "--json"]));
    let names: Vec<&str> =
        models.as_array().expect("a list").iter().filter_map(|model| model["model"].as_str()).collect();
    assert_eq!(names[0], NAME, "the folder in PEERNET_MODELS comes before models/");
}

#[test]
fn models_show_prints_hash_of_file() {
    let file = root().join("models/quality-control/model.onnx");
    let checksum = Command::new("sha256sum").arg(file).output().expect("is installed");
    let checksum = String::from_utf8(checksum.stdout).expect("is text");
    let hash = checksum.split_whitespace().next().expect("a hash");
    assert!(stdout_of_success(&run_models_command(&["show", "quality-control"])).contains(hash));
    let model = json(&run_models_command(&["show", "models/quality-control", "--json"]));
    assert_eq!((model["sha256"].as_str(), model["card"]["version"].as_str()), (Some(hash), Some("1")));
}

#[test]
fn check_runs_on_zeros_and_then_on_pictures() {
    let output = stdout_of_success(&run_models_command(&["check", "quality-control"]));
    assert!(output.contains("run on zeros") && output.contains("of 30 labels right"), "{output}");
    let output = stdout_of_success(&run_models_command(&["check", "defect-detector"]));
    assert!(output.contains("objects found, mAP@0.5 ") && output.contains(" %, mean IoU "), "{output}");
    let output = stdout_of_success(&run_models_command(&["check", NAME]));
    assert!(output.contains("no test pictures"), "{output}");
}

#[test]
fn check_and_run_agree_on_unknown_mask_class() {
    let deployment = LoopbackDeployment::new();
    let [models, pictures] = ["models", "pictures"].map(|name| deployment.folder().join(name));
    let script = root().join("daemon/inference/tests/it/graphs.py");
    let output = Command::new(super::python()).arg(script).arg(&models).output().expect("starts");
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "deploy/install-tools.sh installs what is missing: {error}");
    std::fs::create_dir_all(pictures.join("masks")).expect("made");
    // Both pictures are red, which is class 0. The model has three classes, so it lacks class 5.
    for (name, class) in [("a.png", 0), ("b.png", 5)] {
        RgbImage::from_pixel(120, 80, Rgb([200, 0, 0])).save(pictures.join(name)).expect("written");
        let mask = GrayImage::from_pixel(120, 80, Luma([class]));
        mask.save(pictures.join("masks").join(name)).expect("written");
    }
    deployment.write("pictures/labels.csv", "file,mask\na.png,masks/a.png\nb.png,masks/b.png\n");

    let [models, pictures] = [models, pictures].map(|folder| folder.display().to_string());
    let check =
        run_models_command(&["check", "segmentation", "--models-dir", &models, "--pictures", &pictures]);
    let check = stdout_of_success(&check);

    deployment.write("masks.toml", MASKS);
    let library = onnxruntime().display().to_string();
    let arguments = ["run", "masks.toml", "--result-loc", "results"];
    let environment = [("ORT_DYLIB_PATH", &*library)];
    let run = Process::start(&program("peernet"), &arguments, deployment.folder(), &environment);
    let run = run.wait_for_end();
    assert_eq!(run.code(), 0, "{}", run.log);
    let results = Results::of(deployment.folder().join("results"));
    let rows = results.file(&results.folders()[0], "data.csv");
    let scores: Vec<f64> = column(&rows, "mean-iou").iter().filter_map(|iou| iou.parse().ok()).collect();
    let unknown = column(&rows, "unknown-label").iter().filter(|value| *value == "1").count();
    // b.png has no score, because its class is unknown.
    assert_eq!((scores.len(), unknown), (1, 1));
    let summary = format!(
        "; all pictures together: mean IoU {} % over 1 class; {unknown} label is not a class of the model",
        share(scores[0])
    );
    assert!(check.contains(&summary), "the summary of the check does not contain {summary:?}: {check}");
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
    // With `-S`, Python finds no site packages, as on a machine without torch.
    let script = root().join("models/export_torchvision.py");
    let output = Command::new(super::python()).arg("-S").arg(script).arg(NAME).output().expect("starts");
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success());
    assert!(error.contains("apt-get install python3-torch python3-torchvision python3-onnx"), "{error}");
}
