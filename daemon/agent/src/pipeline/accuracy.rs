//! Accuracy of answers to samples with a label: the values `top-1` and `top-5` of a classification, `map-50` and
//! `mean-iou` of a detection, `mean-iou` of a segmentation.

use peernet_analysis::accuracy::ScoredAnswer;
use peernet_analysis::accuracy::detection::{DETECTION_SCORES, DetectionScores};
use peernet_analysis::accuracy::segmentation::SEGMENTATION_SCORE;
use peernet_logger::stage::{TOP_1, TOP_5, UNKNOWN_LABEL};
use peernet_logger::{Name, Recorder, Unit};
use peernet_sample::Sample;
use peernet_sensors::{SensorError, read_mask};

/// Name of the value that is the mean average precision of the picture.
const MAP_50: Name = Name::from_static(DETECTION_SCORES[0]);
/// Name of the value that is the mean overlap of the labelled objects that were found.
const MEAN_IOU: Name = Name::from_static(DETECTION_SCORES[1]);
/// Name of the value that is the mean ratio of intersection to union of the classes of the picture.
const SEGMENTED_IOU: Name = Name::from_static(SEGMENTATION_SCORE);

/// Records the accuracy of an answer to a sample with the label `label`: `mean-iou` of a segmentation, `map-50` and
/// `mean-iou` of a detection, `top-1` and `top-5` of a classification.
///
/// No accuracy is recorded if the label expects another form of answer, or if the model does not have the class of the
/// label. `unknown-label` shows the second case. The model has recorded it already, unless the label is a mask, which
/// the model does not receive; then it is recorded here.
///
/// # Errors
/// When the mask of the picture cannot be read. Nothing is recorded then.
pub(super) fn record_accuracy(log: &mut Recorder, label: &str, answer: &Sample) -> Result<(), SensorError> {
    let scored = ScoredAnswer::of(label, answer, log.tree(), read_mask)?;
    let is_marked_by_model = log.tree().find(&[UNKNOWN_LABEL.as_str()]).is_some();
    let mut record = |name: Name, value: Option<f64>| {
        if let Some(value) = value {
            log.record_value(name, value, Unit::NONE);
        }
    };
    match scored {
        Some(ScoredAnswer::UnknownLabel) => record(UNKNOWN_LABEL, (!is_marked_by_model).then_some(1.0)),
        Some(ScoredAnswer::Class { is_best, is_in_top }) => {
            record(TOP_1, Some(f64::from(is_best)));
            record(TOP_5, is_in_top.map(f64::from));
        }
        Some(ScoredAnswer::Objects(objects)) => {
            let scores = DetectionScores::of(&[objects]);
            record(MAP_50, Some(scores.map_50));
            record(MEAN_IOU, scores.mean_iou);
        }
        Some(ScoredAnswer::Pixels(pixels)) => record(SEGMENTED_IOU, pixels.mean_iou()),
        None => {}
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, ManualClock, WallTime};
    use peernet_logger::HostId;
    use peernet_sample::{Description, MaskLabel, MediaType};

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
        record_accuracy(&mut log, label, &json).expect("the label names no mask");
        log
    }

    #[test]
    fn label_unknown_to_model_is_not_scored() {
        let clock = ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "system"));
        let mut log = Recorder::new(Arc::new(clock), HostId::random());
        log.record_value(UNKNOWN_LABEL, 1.0, Unit::NONE);
        let json =
            Sample::from_part(Description::unshaped(MediaType::Json), r#"{"label":"a","top":[]}"#.into());
        record_accuracy(&mut log, "tench", &json).expect("the label names no mask");
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
            record_accuracy(&mut log, label, answer).map(|()| value(&log, "mean-iou"))
        };
        let iou_of = |label: &str, answer: &Sample| recorded(label, answer).expect("the mask is there");
        assert_eq!(iou_of(&label, &answer(vec![0, 0, 1, 1, 1, 7])), Some(1.0));
        // Class 0 has an intersection of 2 pixels and a union of 3; so has class 1.
        assert_eq!(iou_of(&label, &answer(vec![0, 0, 1, 1, 0, 7])), Some(2.0 / 3.0));
        assert_eq!(iou_of("road", &answer(vec![0; 6])), None, "the label is no mask");
        // The mask has the classes 0 and 1; the model has one class, and then two.
        for (json, unknown, iou) in
            [(r#"{"class_count":1}"#, Some(1.0), None), (r#"{"class_count":2}"#, None, Some(1.0))]
        {
            let mut counted = answer(vec![0, 0, 1, 1, 1, 7]);
            counted.parts[0].bytes = json.into();
            let clock = ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "system"));
            let mut log = Recorder::new(Arc::new(clock), HostId::random());
            record_accuracy(&mut log, &label, &counted).expect("the mask is there");
            assert_eq!((value(&log, "unknown-label"), value(&log, "mean-iou")), (unknown, iou), "{json}");
        }
        let json = Sample::from_part(Description::unshaped(MediaType::Json), r#"{"label":"a"}"#.into());
        assert_eq!(iou_of(&label, &json), None, "the answer is no segmentation");
        std::fs::remove_file(file).expect("the mask is removed");
        let error = recorded(&label, &answer(vec![0; 6])).expect_err("the file of the mask is missing");
        assert!(error.to_string().contains("mask.png"), "{error}");
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
