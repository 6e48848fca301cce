//! Detectors: boxes of every layout, and of the committed detector of defects.

use std::fs;

use peernet_inference::InferenceError;
use peernet_sample::{MediaType, Sample};
use serde::Deserialize;

use super::graphs::{PICTURE, answer, grey_picture, model, model_table, models};
use super::{bank, demo, jpeg, loaded, run};

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Answer {
    detections: Vec<DetectedObject>,
    width: u32,
    height: u32,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct DetectedObject {
    label: String,
    score: f32,
    r#box: [f32; 4],
}

#[test]
fn boxes_of_every_layout_equal_those_of_numpy() {
    for name in ["yolov5", "yolov8", "yolov8-half", "yolov10", "detr", "rt-detr", "nms", "nms-plain"] {
        let answer = answer(name, vec![grey_picture()]).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(answer.parts[0].description.media, MediaType::Json);
        let answer: Answer = serde_json::from_slice(&answer.parts[0].bytes).expect("has the documented keys");
        assert_eq!((answer.width, answer.height), PICTURE);
        let expected = fs::read(models().join(name).join("expected.json")).expect("is written");
        let expected: Vec<DetectedObject> = serde_json::from_slice(&expected).expect("has these keys");
        assert!(expected.len() > 10, "{name}: too few boxes for a test");
        assert_eq!(answer.detections.len(), expected.len(), "{name}");
        for (found, expected) in answer.detections.iter().zip(&expected) {
            assert_eq!(found.label, expected.label, "{name}");
            assert!((found.score - expected.score).abs() < 1e-5, "{name}: {found:?} {expected:?}");
            for (found, expected) in found.r#box.iter().zip(expected.r#box) {
                assert!((found - expected).abs() < 1e-2, "{name}: {found} {expected}");
            }
        }
    }
}

/// Line of the `labels.csv` of the committed detector's pictures. The line of a picture without a
/// defect has no edges of a box.
#[derive(Debug, Deserialize)]
struct LabelledDefect {
    file: String,
    label: String,
    left: Option<f32>,
    top: Option<f32>,
    right: Option<f32>,
    bottom: Option<f32>,
}

fn overlap(a: [f32; 4], b: [f32; 4]) -> f32 {
    let area = |[left, top, right, bottom]: [f32; 4]| (right - left).max(0.0) * (bottom - top).max(0.0);
    let common = area([a[0].max(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].min(b[3])]);
    common / (area(a) + area(b) - common)
}

#[test]
fn committed_detector_finds_most_defects() {
    let folder = demo().with_file_name("defect-detector");
    let bank = bank(&[&model_table("defects", &folder)]);
    let pool = loaded(&bank, "defects");
    let pictures = folder.join("pictures");
    let mut labels = csv::Reader::from_path(pictures.join("labels.csv")).expect("is committed");
    let (mut all, mut found) = (0, 0);
    for row in labels.deserialize() {
        let row: LabelledDefect = row.expect("has a file and a label");
        let file = fs::read(pictures.join(&row.file)).expect("is committed");
        let answer = run(&pool, jpeg(file)).result.unwrap_or_else(|error| panic!("{error}"));
        let answer: Answer = serde_json::from_slice(&answer.parts[0].bytes).expect("has the documented keys");
        assert_eq!((answer.width, answer.height), (640, 480));
        let (Some(left), Some(top), Some(right), Some(bottom)) = (row.left, row.top, row.right, row.bottom)
        else {
            continue;
        };
        all += 1;
        let is_found = |object: &DetectedObject| {
            object.label == row.label && overlap(object.r#box, [left, top, right, bottom]) >= 0.5
        };
        found += u32::from(answer.detections.iter().any(is_found));
    }
    // The detector finds 21 of 30 defects with the card's thresholds. Another rounding of a pixel may change one or
    // two.
    assert!(all == 30 && found >= 19, "{found} of {all}");
}

#[test]
fn class_without_label_fails_iteration() {
    let error = answer("nms-unknown-class", vec![grey_picture()]).expect_err("class 3 of 0 to 2");
    assert!(matches!(error, InferenceError::Failed { .. }), "{error}");
    assert!(error.to_string().contains("names class 3, its card has labels for 0 to 2"), "{error}");
}

#[test]
fn impossible_numbers_of_detector_fail_iteration() {
    let error = answer("nms-infinite-score", vec![grey_picture()]).expect_err("infinite score");
    assert!(error.to_string().contains("its output \"scores\" contains inf"), "{error}");
    let error = answer("nms-fraction-of-rows", vec![grey_picture()]).expect_err("1.5 rows");
    assert!(error.to_string().contains("states 1.5 valid rows of 150"), "{error}");
}

#[test]
fn labels_of_objects_are_compared_with_classes() {
    let bank = model("yolov8");
    let pool = loaded(&bank, "yolov8");
    let label = |class: &str| {
        format!(r#"{{"objects": [{{"label": "{class}", "box": [0, 0, 1, 1]}}], "width": 120, "height": 80}}"#)
    };
    for (label, is_unknown) in [(label("Nut"), false), (label("screw"), true), ("bolt".to_owned(), false)] {
        let sample = Sample { parts: vec![grey_picture()], source: String::new(), label: Some(label) };
        let tree = run(&pool, sample).recorder.finish();
        assert_eq!(tree.find(&["unknown-label"]).is_some(), is_unknown);
    }
}
