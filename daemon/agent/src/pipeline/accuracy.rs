//! Accuracy of answers to samples with a label: the values `top-1` and `top-5` of a classification, `map-50` and
//! `mean-iou` of a detection, `mean-iou` of a segmentation.

use std::path::Path;

use peernet_analysis::accuracy::detection::{DETECTION_SCORES, DetectionScores, PictureObjects};
use peernet_analysis::accuracy::segmentation::{ClassMap, SEGMENTATION_SCORE, SegmentedPixels};
use peernet_logger::stage::{TOP_1, TOP_5, UNKNOWN_LABEL};
use peernet_logger::{Name, Recorder, Unit};
use peernet_sample::{MaskLabel, MediaType, ObjectsLabel, Sample, normalized_label};
use peernet_sensors::read_mask;
use serde::Deserialize;

/// Name of the value that is the mean average precision of the picture.
const MAP_50: Name = Name::from_static(DETECTION_SCORES[0]);
/// Name of the value that is the mean overlap of the labelled objects that were found.
const MEAN_IOU: Name = Name::from_static(DETECTION_SCORES[1]);
/// Name of the value that is the mean ratio of intersection to union of the classes of the picture.
const SEGMENTED_IOU: Name = Name::from_static(SEGMENTATION_SCORE);
/// Number of best classes that `top-5` considers.
const TOP_5_CLASSES: usize = 5;

/// The fields of a classifier's answer that are read.
#[derive(Debug, Deserialize)]
struct Classification {
    label: String,
    /// Classes, best first; with fewer than five only `top-1` is recorded.
    top: Option<Vec<Class>>,
}

#[derive(Debug, Deserialize)]
struct Class {
    label: String,
}

/// Records the accuracy of an answer to a sample with the label `label`. The label determines what the answer should
/// be:
///
/// - a mask, whose file is read: a segmentation, which is JSON and grey pixels; records `mean-iou`
/// - objects: a detection, which is JSON with `detections`; records `map-50` and `mean-iou`
/// - a class: a classification, which is JSON with `label` and, best first, `top`; records `top-1` and `top-5`
///
/// Records nothing if the answer has another form, or if the model marked a class of the label as unknown
/// (`unknown-label`). If a mask contains a class that the model does not have, records `unknown-label` only.
pub(super) fn record_accuracy(log: &mut Recorder, label: &str, answer: &Sample) {
    // No answer to such a sample can be correct, so the answer says nothing about the accuracy of the model.
    if log.tree().find(&[UNKNOWN_LABEL.as_str()]).is_some() {
        return;
    }
    if let Some(label) = MaskLabel::parse(label) {
        return record_segmentation(log, &label, answer);
    }
    let Some(answer) = json_part(answer) else { return };
    if ObjectsLabel::parse(label).is_some() {
        return record_detection(log, label, answer);
    }
    let Ok(Classification { label: best, top }) = serde_json::from_slice(answer) else { return };
    // A label is often the name of a folder, which may be spelled differently from the model's class.
    let label = normalized_label(label);
    let matches_label = |class: &str| normalized_label(class) == label;
    let is_best = matches_label(&best);
    log.record_value(TOP_1, as_number(is_best), Unit::NONE);
    // If the list has fewer than five classes, the label might be in the list only because the model has so few
    // classes.
    if let Some(top) = top.filter(|top| top.len() >= TOP_5_CLASSES) {
        // A list in another order must not make `top-5` lower than `top-1`.
        let is_in_top = is_best || top.iter().take(TOP_5_CLASSES).any(|class| matches_label(&class.label));
        log.record_value(TOP_5, as_number(is_in_top), Unit::NONE);
    }
}

/// Compares the detected objects of an answer with the labelled objects, and records `map-50` and `mean-iou`.
fn record_detection(log: &mut Recorder, label: &str, answer: &[u8]) {
    let Some(objects) = PictureObjects::read(label, answer) else { return };
    let scores = DetectionScores::of(&[objects]);
    log.record_value(MAP_50, scores.map_50, Unit::NONE);
    if let Some(iou) = scores.mean_iou {
        log.record_value(MEAN_IOU, iou, Unit::NONE);
    }
}

/// Compares the classes of an answer's pixels with the mask that the label names, and records `mean-iou`.
fn record_segmentation(log: &mut Recorder, label: &MaskLabel, sample: &Sample) {
    let Some(answer) = ClassMap::from_answer(sample) else { return };
    let mask = match read_mask(Path::new(&label.mask)) {
        Ok(mask) => mask,
        Err(error) => {
            tracing::warn!(%error, "an answer is not scored, because the mask of its picture cannot be used; correct the file");
            return;
        }
    };
    let Some(mask) = ClassMap::new(mask.width(), mask.height(), mask.pixels()) else { return };
    // The model does not receive the mask, so the model cannot mark a class as unknown itself.
    if mask.has_unknown_class(sample) {
        log.record_value(UNKNOWN_LABEL, 1.0, Unit::NONE);
        return;
    }
    let mut pixels = SegmentedPixels::default();
    pixels.add(mask, answer);
    if let Some(iou) = pixels.mean_iou() {
        log.record_value(SEGMENTED_IOU, iou, Unit::NONE);
    }
}

/// Returns the first part of an answer if it is JSON.
fn json_part(answer: &Sample) -> Option<&[u8]> {
    let part = answer.parts.first().filter(|part| part.description.media == MediaType::Json)?;
    Some(&part.bytes)
}

const fn as_number(condition: bool) -> f64 {
    if condition { 1.0 } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, ManualClock, WallTime};
    use peernet_logger::HostId;
    use peernet_sample::Description;

    use super::*;

    /// Returns `top-1` and `top-5` of an answer, if they are recorded.
    fn top_scores(label: &str, answer: &str) -> (Option<f64>, Option<f64>) {
        scores(&recorded(label, answer))
    }

    fn recorded(label: &str, answer: &str) -> Recorder {
        let clock = ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "system"));
        let mut log = Recorder::new(Arc::new(clock), HostId::random());
        let json =
            Sample::from_part(Description::unshaped(MediaType::Json), answer.as_bytes().to_vec().into());
        record_accuracy(&mut log, label, &json);
        log
    }

    #[test]
    fn label_unknown_to_model_is_not_scored() {
        let clock = ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "system"));
        let mut log = Recorder::new(Arc::new(clock), HostId::random());
        log.record_value(UNKNOWN_LABEL, 1.0, Unit::NONE);
        let json =
            Sample::from_part(Description::unshaped(MediaType::Json), r#"{"label":"a","top":[]}"#.into());
        record_accuracy(&mut log, "tench", &json);
        assert_eq!(scores(&log), (None, None));
    }

    fn scores(log: &Recorder) -> (Option<f64>, Option<f64>) {
        (value(log, "top-1"), value(log, "top-5"))
    }

    fn value(log: &Recorder, name: &str) -> Option<f64> {
        log.tree().find(&[name]).and_then(|(_, node)| node.measure.value())
    }

    #[test]
    fn detections_are_compared_with_labelled_objects() {
        let objects = r#"{"label":"a","box":[0,0,10,10]},{"label":"b","box":[20,0,30,10]}"#;
        let label = &*format!(r#"{{"objects":[{objects}],"width":30,"height":10}}"#);
        let answer = |found: &str| format!(r#"{{"detections":[{found}],"width":30,"height":10}}"#);
        let one_of_two = answer(r#"{"label":"a","score":0.9,"box":[0,0,8,10]}"#);
        let log = recorded(label, &one_of_two);
        assert_eq!((value(&log, "map-50"), value(&log, "mean-iou")), (Some(0.5), Some(0.8)));
        let log = recorded(label, &answer(""));
        assert_eq!((value(&log, "map-50"), value(&log, "mean-iou")), (Some(0.0), None));
        // A label of another kind says nothing about the answer.
        assert_eq!(value(&recorded("a", &one_of_two), "map-50"), None);
        assert_eq!(top_scores(label, r#"{"label":"a","top":[]}"#), (None, None));
    }

    #[test]
    fn segmentation_is_compared_with_mask() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("mask.png");
        // A grey file: its levels are the numbers of the classes, and 255 is not scored.
        image::GrayImage::from_raw(3, 2, vec![0, 0, 1, 1, 1, 255])
            .expect("six pixels")
            .save(&file)
            .expect("the mask is written");
        let label = MaskLabel { mask: file.to_str().expect("is UTF-8").to_owned() }.format();
        let answer = |classes: Vec<u8>| {
            let mut answer = Sample::from_part(Description::unshaped(MediaType::Json), "{}".into());
            let pixels = Description::pixels(peernet_sample::PixelFormat::Grey8, 3, 2);
            answer.parts.extend(Sample::from_part(pixels, classes.into()).parts);
            answer
        };
        let recorded = |label: &str, answer: &Sample| {
            let clock = ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "system"));
            let mut log = Recorder::new(Arc::new(clock), HostId::random());
            record_accuracy(&mut log, label, answer);
            value(&log, "mean-iou")
        };
        assert_eq!(recorded(&label, &answer(vec![0, 0, 1, 1, 1, 7])), Some(1.0));
        // Class 0 has an intersection of 2 pixels and a union of 3; so has class 1.
        assert_eq!(recorded(&label, &answer(vec![0, 0, 1, 1, 0, 7])), Some(2.0 / 3.0));
        assert_eq!(recorded("road", &answer(vec![0; 6])), None, "the label is no mask");
        // The mask has the classes 0 and 1; the model has one class, and then two.
        for (json, unknown, iou) in
            [(r#"{"class_count":1}"#, Some(1.0), None), (r#"{"class_count":2}"#, None, Some(1.0))]
        {
            let mut counted = answer(vec![0, 0, 1, 1, 1, 7]);
            counted.parts[0].bytes = json.into();
            let clock = ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "system"));
            let mut log = Recorder::new(Arc::new(clock), HostId::random());
            record_accuracy(&mut log, &label, &counted);
            assert_eq!((value(&log, "unknown-label"), value(&log, "mean-iou")), (unknown, iou), "{json}");
        }
        let json = Sample::from_part(Description::unshaped(MediaType::Json), r#"{"label":"a"}"#.into());
        assert_eq!(recorded(&label, &json), None, "the answer is no segmentation");
        std::fs::remove_file(file).expect("the mask is removed");
        assert_eq!(recorded(&label, &answer(vec![0; 6])), None, "the file of the mask is missing");
    }

    #[test]
    fn top_one_and_top_five_are_compared_with_label() {
        let top: Vec<_> =
            ["a", "b", "c", "d", "e", "f"].map(|l| format!(r#"{{"label":"{l}","score":0.1}}"#)).into();
        let answer = format!(r#"{{"label":"a","score":0.1,"top":[{}]}}"#, top.join(","));
        for (label, expected) in [("a", (1.0, 1.0)), ("e", (0.0, 1.0)), ("f", (0.0, 0.0)), ("z", (0.0, 0.0))]
        {
            assert_eq!(top_scores(label, &answer), (Some(expected.0), Some(expected.1)), "{label}");
        }
    }

    #[test]
    fn folder_name_matches_class_in_other_spelling() {
        let answer = r#"{"label":"golden retriever"}"#;
        assert_eq!(top_scores("Golden_Retriever", answer), (Some(1.0), None));
        assert_eq!(top_scores("golden", answer), (Some(0.0), None));
    }

    #[test]
    fn answer_with_fewer_than_five_classes_has_no_top_five_score() {
        assert_eq!(top_scores("a", r#"{"label":"a"}"#), (Some(1.0), None));
        let top = ["a", "b", "c", "d"].map(|class| format!(r#"{{"label":"{class}","score":0.1}}"#)).join(",");
        assert_eq!(top_scores("b", &format!(r#"{{"label":"a","top":[{top}]}}"#)), (Some(0.0), None));
        for answer in [r#"{"boxes":[]}"#, "{", "[]", r#"{"label":3}"#] {
            assert_eq!(top_scores("a", answer), (None, None), "{answer}");
        }
    }
}
