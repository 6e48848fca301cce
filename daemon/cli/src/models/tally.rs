//! Comparison of a model's answers with the labels of its test pictures.

use peernet_analysis::accuracy::ScoredAnswer;
use peernet_analysis::accuracy::detection::{DetectionScores, PictureObjects};
use peernet_analysis::accuracy::segmentation::SegmentedPixels;
use peernet_logger::Tree;
use peernet_sample::{Classification, Description, Sample};
use peernet_sensors::{SensorError, read_mask};
use peernet_statistics::number::{count, counted, counted_with_plural, fixed, share};

/// Longest answer that is shown, bytes.
const MAX_SHOWN_BYTES: usize = 2_000;

/// Comparison of all answers so far with their labels.
#[derive(Default)]
pub(super) struct Tally {
    /// Number of classifications that agree with their label.
    right: u64,
    /// Number of classifications whose label is a class of the model.
    labelled: u64,
    /// Number of labels that are not classes of the model, and of masks with a class that the model does not have.
    unknown_labels: u64,
    /// Labelled and found objects of each picture that has boxes.
    pictures: Vec<PictureObjects>,
    /// Pixels of each class, of all pictures that have a mask.
    pixels: SegmentedPixels,
}

impl Tally {
    /// Compares an answer with the label of its picture. `measurements` are those of the answer; in them the model
    /// marks a label that is not one of its classes. An answer that is no classification, detection or segmentation is
    /// not counted.
    ///
    /// # Errors
    /// If the label names a mask that cannot be read.
    pub(super) fn add(
        &mut self,
        label: &str,
        answer: &Sample,
        measurements: &Tree,
    ) -> Result<(), SensorError> {
        match ScoredAnswer::of(label, answer, measurements, read_mask)? {
            Some(ScoredAnswer::UnknownLabel) => self.unknown_labels += 1,
            Some(ScoredAnswer::Class { is_best, .. }) => {
                self.labelled += 1;
                self.right += u64::from(is_best);
            }
            Some(ScoredAnswer::Objects(objects)) => self.pictures.push(objects),
            Some(ScoredAnswer::Pixels(pixels)) => self.pixels.merge(&pixels),
            None => {}
        }
        Ok(())
    }

    /// Returns the counts, each after a semicolon.
    pub(super) fn text(&self) -> String {
        let Self { right, labelled, .. } = self;
        let accuracy =
            (*labelled > 0).then(|| format!("; {} of {} labels right", count(*right), count(*labelled)));
        let unknown = match self.unknown_labels {
            0 => None,
            1 => Some("; 1 label is not a class of the model".to_owned()),
            unknown => Some(format!("; {} labels are not classes of the model", count(unknown))),
        };
        [accuracy, self.detection(), self.segmentation(), unknown].into_iter().flatten().collect()
    }

    /// Returns the score of the pixels of all pictures together.
    fn segmentation(&self) -> Option<String> {
        let class_count = self.pixels.class_count();
        let classes = counted_with_plural(class_count as u64, "class", "classes");
        self.pixels
            .mean_iou()
            .map(|iou| format!("; all pictures together: mean IoU {} % over {classes}", share(iou)))
    }

    /// Returns the scores of the boxes of all pictures together.
    fn detection(&self) -> Option<String> {
        if self.pictures.is_empty() {
            return None;
        }
        let scores = DetectionScores::of(&self.pictures);
        let iou = scores.mean_iou.map(|iou| format!(", mean IoU {} %", share(iou))).unwrap_or_default();
        let found_text = format!("{} of {} found", count(scores.matched), counted(scores.labelled, "object"));
        Some(format!("; all pictures together: {found_text}, mAP@0.5 {} %{iou}", share(scores.map_50)))
    }
}

/// Returns an answer as text: class and score of a classification, other JSON as it is, and a description of other
/// parts.
pub(super) fn describe(answer: &Sample) -> String {
    if let Some(Classification { label, score }) = answer.classification() {
        return format!("{label} ({})", fixed(score, 3));
    }
    if let Some(json) = answer.json().filter(|json| json.len() <= MAX_SHOWN_BYTES) {
        return String::from_utf8_lossy(json).into_owned();
    }
    let part = |Description { media, shape, element }: &Description| {
        let shape = shape.iter().map(u32::to_string).collect::<Vec<_>>().join(" × ");
        let element = element.map_or_else(String::new, |element| format!(" {element:?}").to_lowercase());
        format!("{} {shape}{element}", media.iana())
    };
    answer.parts.iter().map(|answer_part| part(&answer_part.description)).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, ManualClock, WallTime};
    use peernet_logger::stage::UNKNOWN_LABEL;
    use peernet_logger::{HostId, Recorder, Unit};
    use peernet_sample::{ElementType, MaskLabel, MediaType, PixelFormat};

    use super::*;

    /// Returns the measurements of an answer, in which the model marks the label if it `is_unknown`.
    fn measurements(is_unknown: bool) -> Tree {
        let clock = ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "system"));
        let mut recorder = Recorder::new(Arc::new(clock), HostId::random());
        if is_unknown {
            recorder.record_value(UNKNOWN_LABEL, 1.0, Unit::NONE);
        }
        recorder.finish()
    }

    fn answer(json: &'static str) -> Sample {
        Sample::from_part(Description::unshaped(MediaType::Json), json.into())
    }

    #[test]
    fn classifications_are_compared_with_labels() {
        let mut tally = Tally::default();
        assert_eq!(tally.text(), "");
        let good = answer(r#"{"label": "good", "score": 0.75}"#);
        for (label, is_unknown) in [("Good", false), ("hole missing", false), ("bent", true)] {
            tally.add(label, &good, &measurements(is_unknown)).expect("no file is read");
        }
        assert_eq!(tally.text(), "; 1 of 2 labels right; 1 label is not a class of the model");
        assert_eq!(describe(&answer(r#"{"label": "good", "score": 0.75}"#)), "good (0.750)");
    }

    #[test]
    fn boxes_of_all_pictures_are_scored_together() {
        let mut tally = Tally::default();
        let label = |class: &str| {
            format!(
                r#"{{"objects": [{{"label": "{class}", "box": [0, 0, 10, 10]}}], "width": 20, "height": 20}}"#
            )
        };
        let found = r#"{"detections": [{"label": "dent", "score": 0.9, "box": [0, 0, 10, 8]}], "width": 20, "height": 20}"#;
        let none = r#"{"detections": [], "width": 20, "height": 20}"#;
        for (class, found) in [("dent", found), ("dent", none), ("hole", found)] {
            tally
                .add(&label(class), &answer(found), &measurements(class == "hole"))
                .expect("no file is read");
        }
        assert_eq!(
            tally.text(),
            "; all pictures together: 1 of 2 objects found, mAP@0.5 50.0 %, mean IoU 80.0 %; 1 label is not a class of the model"
        );
    }

    #[test]
    fn pixels_of_all_pictures_are_scored_together() {
        let folder = tempfile::tempdir().expect("a folder");
        let label = |name: &str| {
            let mask = folder.path().join(name).to_str().expect("is UTF-8").to_owned();
            MaskLabel { mask }.format()
        };
        let segmentation = |class: u8| {
            let pixels = Description::pixels(PixelFormat::Grey8, 1, 1);
            let mut whole = answer(r#"{"class_count": 2}"#);
            whole.parts.extend(Sample::from_part(pixels, vec![class].into()).parts);
            whole
        };
        let mut tally = Tally::default();
        // The model has the classes 0 (road) and 1 (lane).
        for (name, mask, answered) in [("a.png", 0, 0), ("b.png", 0, 1), ("c.png", 5, 0)] {
            let file = folder.path().join(name);
            image::GrayImage::from_raw(1, 1, vec![mask]).expect("fits").save(&file).expect("written");
            tally.add(&label(name), &segmentation(answered), &measurements(false)).expect("is read");
        }
        // IoU of road: 1 pixel of 2 in the union; of lane: 0 pixels of 1 in the union.
        assert_eq!(
            tally.text(),
            "; all pictures together: mean IoU 25.0 % over 2 classes; 1 label is not a class of the model"
        );
        let missing = tally.add(&label("d.png"), &segmentation(0), &measurements(false));
        let error = missing.expect_err("is gone").to_string();
        assert!(error.contains("d.png"), "{error}");
    }

    #[test]
    fn arrays_are_described() {
        let description =
            Description { media: MediaType::Tensor, shape: vec![1, 7], element: Some(ElementType::F32) };
        let action = Sample::from_part(description, vec![0; 28].into());
        assert_eq!(describe(&action), "application/x-tensor 1 × 7 f32");
    }
}
