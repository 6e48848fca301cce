use std::fs;

use peernet_inference::{Bank, LibraryError, LoadError, ModelConfig, OnnxRuntimeConfig};

use super::{bank, clock, demo, loaded, quality_control, quality_control_with, slug};

fn load_refusal(bank: &Bank, name: &str, device: Option<&str>) -> LoadError {
    bank.load(&slug(name), device).expect_err("is refused")
}

#[test]
fn unknown_model_is_refused_with_offered_models() {
    let two = bank(&[&quality_control(), "name = \"echo\"\nkind = \"echo\""]);
    let error = load_refusal(&two, "qd", None);
    assert_eq!(error.to_string(), "no model named qd; this host offers qc, echo");
    let error = load_refusal(&bank(&[]), "qd", None).to_string();
    assert!(error.contains("this host offers none: add a [[model]]"), "{error}");
}

#[test]
fn refusal_of_device_names_offered_device() {
    let error = load_refusal(&bank(&[&quality_control()]), "qc", Some("cuda:0")).to_string();
    assert_eq!(error, "model qc is not offered on cuda:0, only on cpu; request an offered device or none");
    let error = load_refusal(&bank(&[&quality_control_with("device = \"gpu\"")]), "qc", None).to_string();
    assert!(error.contains("\"gpu\" is not a device") && error.contains("cuda:N"), "{error}");
}

#[test]
fn check_finds_two_models_with_one_name() {
    let errors = bank(&["name = \"a\"\nkind = \"echo\"", "name = \"a\"\nkind = \"sleep\""]).check();
    assert!(matches!(errors.as_slice(), [(1, LoadError::Duplicate(name))] if name == "a"), "{errors:?}");
}

/// The library of the tests is built for the CPU only.
#[test]
fn unsupported_device_is_refused_with_reason() {
    for (device, provider) in [
        ("cuda:0", "CUDAExecutionProvider"),
        ("tensorrt:0", "TensorrtExecutionProvider"),
        ("openvino:CPU", "OpenVINOExecutionProvider"),
    ] {
        let bank = bank(&[&quality_control_with(&format!("device = \"{device}\""))]);
        for error in bank.check().into_iter().map(|(_, error)| error).chain([load_refusal(&bank, "qc", None)])
        {
            assert!(matches!(error, LoadError::NoProvider { .. }), "{error}");
            let text = error.to_string();
            for part in [device, provider, "libonnxruntime", "it has CPUExecutionProvider", "ORT_DYLIB_PATH"]
            {
                assert!(text.contains(part), "{part}: {text}");
            }
        }
    }
}

#[test]
fn second_library_is_refused_in_one_process() {
    let first = bank(&[&quality_control()]);
    loaded(&first, "qc");
    let folder = tempfile::tempdir().expect("can be made");
    let library = folder.path().join("libonnxruntime.so");
    fs::write(&library, "").expect("can be written");
    let model: ModelConfig = toml::from_str(&quality_control()).expect("is right");
    let second = Bank::new(vec![model], OnnxRuntimeConfig { library: Some(library) }, clock());
    let error = load_refusal(&second, "qc", None);
    assert!(matches!(error, LoadError::Library(LibraryError::OtherLibraryLoaded { .. })), "{error}");
}

/// Creates a folder with these files of a model, and a bank with the model.
fn write_model(model: &[u8], card: &str) -> (tempfile::TempDir, Bank) {
    let folder = tempfile::tempdir().expect("can be made");
    fs::write(folder.path().join("model.onnx"), model).expect("can be written");
    fs::write(folder.path().join("model.toml"), card).expect("can be written");
    let config = format!("name = \"qc\"\nkind = \"onnx\"\npath = {:?}", folder.path());
    let bank = bank(&[&config]);
    (folder, bank)
}

#[test]
fn missing_and_broken_files_are_named() {
    let missing = bank(&["name = \"qc\"\nkind = \"onnx\"\npath = \"/nowhere\""]);
    let error = load_refusal(&missing, "qc", None).to_string();
    assert!(error.contains("/nowhere/model.toml"), "{error}");
    assert!(
        error.ends_with("write a card for the model (docs/models.md), or correct the path of its folder"),
        "{error}"
    );

    let card = fs::read_to_string(demo().join("model.toml")).expect("is committed");
    let (_folder, bank) = write_model(b"this is no model", &card);
    let error = load_refusal(&bank, "qc", None);
    assert!(matches!(error, LoadError::File { .. }), "{error}");
    assert!(error.to_string().contains("model.onnx: it is not an ONNX model"), "{error}");
}

#[test]
fn card_that_contradicts_model_is_refused_at_load() {
    let model = fs::read(demo().join("model.onnx")).expect("is committed");
    let card = fs::read_to_string(demo().join("model.toml")).expect("is committed");
    for (from, to, expected) in [
        ("name = \"image\"", "name = \"picture\"", "its card names the input \"picture\""),
        ("name = \"logits\"", "name = \"scores\"", "its card names the output \"scores\""),
        ("\"hole missing\"]", "\"hole missing\", \"bent\"]", "[1, 5]"),
        ("colour = \"rgb\"", "colour = \"grey\"", "3 channels"),
    ] {
        let (_folder, bank) = write_model(&model, &card.replace(from, to));
        let error = load_refusal(&bank, "qc", None).to_string();
        assert!(error.contains(expected), "{expected}: {error}");
    }
}
