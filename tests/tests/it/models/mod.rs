//! Tests of the model bank: models on disk, models exported from torchvision, and the commands `peernet models …`.

mod commands;
mod torchvision;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use peernet_tests::root;
use serde::Deserialize;

/// Picture with torchvision's output.
#[derive(Debug, Deserialize)]
struct ReferenceAnswer {
    file: PathBuf,
    width: u32,
    height: u32,
    /// File of its pixels, as Pillow decodes them.
    pixels: PathBuf,
    logits: Vec<f64>,
}

/// EfficientNetV2-S with random weights in a folder of models, and its answers.
#[derive(Debug)]
struct ExportedModel {
    /// Folder of models, which contains the exported model.
    models: PathBuf,
    answers: Vec<ReferenceAnswer>,
}

const NAME: &str = "efficientnet_v2_s";

/// Exports the model once for all tests, which takes some seconds.
fn exported_model() -> &'static ExportedModel {
    static EXPORTED: OnceLock<ExportedModel> = OnceLock::new();
    EXPORTED.get_or_init(|| {
        let models = create_process_folder();
        let pictures = ["part-0001.jpg", "part-0028.jpg"];
        let pictures = pictures.map(|name| root().join("models/quality-control/pictures").join(name));
        let script = root().join("tests/tests/it/models/reference.py");
        let output = Command::new(python()).arg(script).arg(&models).args(pictures).output();
        let output = output.expect("deploy/install-tools.sh installs Python");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "deploy/install-tools.sh installs what is missing: {errors}");
        let answers = std::fs::read(models.join("answers.json")).expect("the script wrote it");
        ExportedModel {
            models,
            answers: serde_json::from_slice(&answers).expect("the script writes these keys"),
        }
    })
}

/// Returns the folder of models that contains the exported model, for tests of other features.
pub(crate) fn exported_models() -> &'static Path {
    &exported_model().models
}

/// Returns the interpreter in `PEERNET_PYTHON`, or else the system's. Other interpreters do not find
/// Debian's packages.
fn python() -> PathBuf {
    std::env::var_os("PEERNET_PYTHON").map_or_else(|| "/usr/bin/python3".into(), PathBuf::from)
}

/// Creates a folder for this process, and removes the folders of ended processes.
fn create_process_folder() -> PathBuf {
    let parent = Path::new(env!("CARGO_TARGET_TMPDIR"));
    for entry in std::fs::read_dir(parent).expect("cargo creates the folder") {
        let entry = entry.expect("is readable");
        let name = entry.file_name().to_string_lossy().into_owned();
        if let Some(process) = name.strip_prefix("torchvision-")
            && !Path::new("/proc").join(process).exists()
        {
            std::fs::remove_dir_all(entry.path()).expect("is ours");
        }
    }
    let folder = parent.join(format!("torchvision-{}", std::process::id()));
    std::fs::create_dir(&folder).expect("is new");
    folder
}
