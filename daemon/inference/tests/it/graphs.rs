//! Models of all tasks: small graphs that `graphs.py` writes, together with the answers that numpy computes.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use peernet_inference::{Bank, InferenceError, LoadError};
use peernet_sample::{Description, ElementType, MediaType, Part, PixelFormat, Sample};
use serde_json::Value;

use super::{bank, loaded, run, slug};

/// Size of the picture in `graphs.py`.
pub(super) const PICTURE: (u32, u32) = (120, 80);

/// Returns the folder with the models. The first call writes the models.
pub(super) fn models() -> &'static Path {
    static MODELS: OnceLock<PathBuf> = OnceLock::new();
    MODELS.get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("graphs");
        // Only the system's interpreter finds the packages of Debian.
        let python = std::env::var_os("PEERNET_PYTHON").unwrap_or_else(|| "/usr/bin/python3".into());
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/it/graphs.py");
        let output = Command::new(python).arg(script).arg(&folder).output().expect("Python is installed");
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(
            output.status.success(),
            "graphs.py failed; deploy/install-tools.sh installs missing packages: {error}"
        );
        folder
    })
}

/// Returns the `[[model]]` table of the model in a folder.
pub(super) fn model_table(name: &str, folder: &Path) -> String {
    format!("name = \"{name}\"\nkind = \"onnx\"\npath = {folder:?}")
}

pub(super) fn model(name: &str) -> Bank {
    bank(&[&model_table(name, &models().join(name))])
}

pub(super) fn answer(name: &str, parts: Vec<Part>) -> Result<Sample, InferenceError> {
    let bank = model(name);
    run(&loaded(&bank, name), Sample { parts, source: String::new(), label: None }).result
}

pub(super) fn pixels((width, height): (u32, u32), bytes: Vec<u8>) -> Part {
    Part { description: Description::pixels(PixelFormat::Rgb8, width, height), bytes: bytes.into() }
}

pub(super) fn grey_picture() -> Part {
    pixels(PICTURE, vec![128; (PICTURE.0 * PICTURE.1 * 3) as usize])
}

pub(super) fn array(element: ElementType, shape: &[u32], bytes: Vec<u8>) -> Part {
    let description = Description { media: MediaType::Tensor, shape: shape.to_vec(), element: Some(element) };
    Part { description, bytes: bytes.into() }
}

pub(super) fn bytes(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

pub(super) fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks().0.iter().map(|number| f32::from_le_bytes(*number)).collect()
}

#[test]
fn every_element_type_passes_unchanged() {
    let cases: [(&str, ElementType, Vec<u8>); 12] = [
        ("float16", ElementType::F16, vec![0x00, 0x3c, 0x00, 0xc0, 0xff, 0x7b]),
        ("float32", ElementType::F32, bytes(&[1.5, f32::INFINITY, -0.0])),
        (
            "float64",
            ElementType::F64,
            [1e300, -2.5, 0.0].iter().flat_map(|n: &f64| n.to_le_bytes()).collect(),
        ),
        ("int8", ElementType::I8, vec![1, 0x80, 0xff]),
        ("int16", ElementType::I16, vec![1, 0, 0, 0x80, 0xff, 0xff]),
        ("int32", ElementType::I32, vec![1, 2, 3, 4, 0, 0, 0, 0x80, 5, 6, 7, 8]),
        ("int64", ElementType::I64, (0..24).rev().collect()),
        ("uint8", ElementType::U8, vec![0, 128, 255]),
        ("uint16", ElementType::U16, vec![1, 2, 3, 4, 0xff, 0xff]),
        ("uint32", ElementType::U32, (200..212).collect()),
        ("uint64", ElementType::U64, (100..124).collect()),
        ("bool", ElementType::Bool, vec![1, 0, 1]),
    ];
    for (name, element, bytes) in cases {
        let part = array(element, &[3], bytes);
        let answer =
            answer(&format!("identity-{name}"), vec![part.clone()]).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(answer.parts, [part], "{name}");
    }
}

#[test]
fn policy_gets_picture_state_and_constant() {
    let front = || pixels((2, 2), vec![100, 50, 0, 100, 50, 0, 100, 50, 0, 100, 50, 0]);
    let state = |numbers: &[f32]| array(ElementType::F32, &[1, numbers.len() as u32], bytes(numbers));
    let bank = model("policy");
    let pool = loaded(&bank, "policy");
    let sample = |parts| Sample { parts, source: "episode 1".to_owned(), label: Some("reached".to_owned()) };
    let done = run(&pool, sample(vec![front(), state(&[1.0, -2.0])]));
    let answer = done.result.unwrap_or_else(|error| panic!("{error}"));
    // 2 × state + mean of the bytes + constant.
    assert_eq!(
        answer.parts,
        [
            array(ElementType::F32, &[1, 2], bytes(&[2.0 + 50.0 + 10.0, -4.0 + 50.0 - 1000.0])),
            array(ElementType::Bool, &[1, 2], vec![1, 0]),
        ]
    );
    assert!(done.recorder.finish().find(&["unknown-label"]).is_none(), "the model has no classes");

    let error = run(&pool, sample(vec![front(), state(&[1.0])])).result.expect_err("is too short");
    assert!(matches!(error, InferenceError::Input { .. }), "{error}");
    assert!(error.to_string().contains("part 2 for input \"state\": its array is float32 [1, 1]"), "{error}");
    let error = run(&pool, sample(vec![front()])).result.expect_err("lacks a part").to_string();
    assert!(error.contains("it has 1 part, the model takes 2: front, state"), "{error}");
}

#[test]
fn nan_in_output_fails_iteration_with_reason() {
    let bank = model("root");
    let pool = loaded(&bank, "root");
    let compute = |numbers: &[f32; 3]| {
        let parts = vec![array(ElementType::F32, &[3], bytes(numbers))];
        run(&pool, Sample { parts, source: String::new(), label: None }).result
    };
    let error = compute(&[1.0, -1.0, 4.0]).expect_err("has no root");
    assert_eq!(error.to_string(), "model root failed: its output \"y\" contains NaN");
    let answer = compute(&[1.0, 9.0, 4.0]).expect("the next sample succeeds");
    assert_eq!(floats(&answer.parts[0].bytes), [1.0, 3.0, 2.0]);
}

#[test]
fn letterboxed_picture_equals_that_of_numpy() {
    let folder = models().join("picture");
    let picture = pixels(PICTURE, fs::read(folder.join("picture.rgb")).expect("is written"));
    let answer = answer("picture", vec![picture]).unwrap_or_else(|error| panic!("{error}"));
    let expected = floats(&fs::read(folder.join("expected.f32")).expect("is written"));
    let found = floats(&answer.parts[0].bytes);
    assert_eq!(found.len(), expected.len());
    // Because of rounding, bytes may differ by 1 of 255. The smallest `std` is 0.5.
    let max_difference = 1.01 / 255.0 / 0.5;
    let largest_difference = found.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(largest_difference < max_difference, "{largest_difference}");
    let differing = found.iter().zip(&expected).filter(|(a, b)| (*a - *b).abs() > 1e-4).count();
    assert!(differing * 5 < found.len(), "{differing} of {}", found.len());
}

#[test]
fn class_map_has_regions_of_picture() {
    // The left third is red, the rest is blue. The picture has another size than the model's input.
    let red = |x: u32| if x < 40 { [200, 10, 0] } else { [0, 10, 200] };
    let bytes: Vec<u8> = (0..PICTURE.1).flat_map(|_| (0..PICTURE.0).flat_map(red)).collect();
    for name in ["segmentation", "segmentation-classes"] {
        let answer =
            answer(name, vec![pixels(PICTURE, bytes.clone())]).unwrap_or_else(|error| panic!("{error}"));
        let summary: Value = serde_json::from_slice(&answer.parts[0].bytes).expect("is JSON");
        assert_eq!((&summary["classes"][0]["label"], &summary["width"]), (&"blue".into(), &120.into()));
        assert_eq!(summary["classes"].as_array().map(Vec::len), Some(2), "{summary}");
        let map = &answer.parts[1];
        assert_eq!(map.description, Description::pixels(PixelFormat::Grey8, PICTURE.0, PICTURE.1));
        for (at, class) in map.bytes.iter().enumerate() {
            // Resizing merges columns, so the border may be anywhere in columns 38 to 41.
            match at as u32 % PICTURE.0 {
                0..=37 => assert_eq!(*class, 0, "{name} {at}"),
                42.. => assert_eq!(*class, 2, "{name} {at}"),
                _ => {}
            }
        }
    }
}

#[test]
fn embedding_has_length_one() {
    let answer = answer("embedding", vec![grey_picture()]).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(answer.parts[0].description, array(ElementType::F32, &[3], Vec::new()).description);
    let vector = floats(&answer.parts[0].bytes);
    let length: f32 = vector.iter().map(|number| number * number).sum();
    assert!((length - 1.0).abs() < 1e-5 && (vector[0] - vector[2]).abs() < 1e-6, "{vector:?}");
}

#[test]
fn mismatch_error_names_field_of_card() {
    for (name, from, to, expected) in [
        (
            "policy",
            "name = \"state\"",
            "name = \"states\"",
            "its card names the input \"states\", but it has \"front\", \"state\", \"offset\"",
        ),
        (
            "policy",
            "dtype = \"uint8\"",
            "dtype = \"int8\"",
            "its input \"front\" is uint8 of shape [1, 2, 2, 3], its card says int8 of shape",
        ),
        (
            "policy",
            "shape = [1, 2]\n[[input]]",
            "shape = [1, 3]\n[[input]]",
            "its card says float32 of shape [1, 3]",
        ),
        (
            "policy",
            "dtype = \"bool\"",
            "dtype = \"uint8\"",
            "its output \"done\" is bool of shape [1, 2], its card says uint8 of shape",
        ),
        (
            "yolov8",
            "[\"bolt\", \"nut\", \"washer\"]",
            "[\"bolt\", \"nut\"]",
            "its card says float32, float16 or float64 of shape [1, 6, n], because `labels` has 2; write a label for each",
        ),
        ("detr", "activation = \"softmax\"", "activation = \"sigmoid\"", "its output \"logits\" is"),
        ("nms", "count = \"count\"", "count = \"number\"", "its card names the output \"number\""),
    ] {
        let folder = tempfile::tempdir().expect("can be made");
        let source = models().join(name);
        fs::copy(source.join("model.onnx"), folder.path().join("model.onnx")).expect("can be copied");
        let card = fs::read_to_string(source.join("model.toml")).expect("is written");
        assert!(card.contains(from), "{from}");
        fs::write(folder.path().join("model.toml"), card.replacen(from, to, 1)).expect("can be written");
        let bank = bank(&[&model_table("changed", folder.path())]);
        let error = bank.load(&slug("changed"), None).expect_err(to);
        assert!(matches!(error, LoadError::File { .. }), "{error}");
        assert!(error.to_string().contains(expected), "{to}: {error}");
    }
}

#[test]
fn refusal_of_newer_format_names_supported_version() {
    let folder = tempfile::tempdir().expect("can be made");
    let source = models().join("policy");
    let mut graph = fs::read(source.join("model.onnx")).expect("is written");
    // A file of the ONNX format begins with the tag 8 and the version of the format.
    assert_eq!(graph[..2], [8, 8]);
    graph[1] = 99;
    fs::write(folder.path().join("model.onnx"), graph).expect("can be written");
    fs::copy(source.join("model.toml"), folder.path().join("model.toml")).expect("can be copied");
    let error =
        bank(&[&model_table("newer", folder.path())]).load(&slug("newer"), None).expect_err("is newer");
    let text = error.to_string();
    assert!(text.contains("Unsupported model IR version: 99, max supported IR version: "), "{text}");
    assert!(text.contains("after `model.ir_version = ") && !text.contains("model.cc"), "{text}");
}

#[test]
fn error_names_input_that_card_omits() {
    let folder = tempfile::tempdir().expect("can be made");
    let source = models().join("policy");
    fs::copy(source.join("model.onnx"), folder.path().join("model.onnx")).expect("can be copied");
    let card = fs::read_to_string(source.join("model.toml")).expect("is written");
    let (before, rest) = card.split_once("[[input]]\nname = \"offset\"").expect("is there");
    let (_, after) = rest.split_once("[preprocessing]").expect("is there");
    fs::write(folder.path().join("model.toml"), format!("{before}[preprocessing]{after}")).expect("written");
    let error = bank(&[&model_table("changed", folder.path())])
        .load(&slug("changed"), None)
        .expect_err("the card lacks an input");
    assert!(
        error.to_string().contains("it has the input \"offset\", which its card does not name"),
        "{error}"
    );
}
