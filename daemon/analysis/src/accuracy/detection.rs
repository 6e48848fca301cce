//! Scores of a detector: mean average precision, and the overlap of found and labelled boxes.
//!
//! Average precision is the area under the curve of precision over recall. The precision at each recall is first
//! replaced with the largest precision at this or a higher recall (M. Everingham et al., *The PASCAL Visual Object
//! Classes Challenge*, IJCV 88, 2010). The area uses all points of the curve, as the challenge does from 2010 on, and
//! not eleven of them.

use std::collections::{BTreeMap, BTreeSet};

use peernet_sample::{ObjectsLabel, iou, normalized_label};
use serde::Deserialize;

/// Names of the scores of an iteration with labelled boxes: the mean average precision of its picture, and the mean overlap of the found
/// objects.
pub const DETECTION_SCORES: [&str; 2] = ["map-50", "mean-iou"];

/// A found box is at the place of a labelled object if the intersection of both boxes divided by their union is at
/// least this ratio.
pub const MATCHING_IOU: f64 = 0.5;

/// Box of an object, labelled or found.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectBox {
    /// Class of the object. Classes are compared as texts.
    pub class: String,
    /// Left, top, right and bottom edge, in one unit for all boxes of a picture.
    pub edges: [f64; 4],
}

/// Labelled and found objects of one picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PictureObjects {
    /// The objects that are in the picture.
    pub labelled: Vec<ObjectBox>,
    /// The objects that were found, each with its score.
    pub found: Vec<(ObjectBox, f64)>,
}

/// Keys that are read from a detector's answer. All other keys are ignored.
#[derive(Deserialize)]
struct Answer {
    detections: Vec<FoundObject>,
    width: f64,
    height: f64,
}

/// Object in a detector's answer. The edges of its box are in the unit of the answer's `width` and `height`.
#[derive(Deserialize)]
struct FoundObject {
    label: String,
    score: f64,
    #[serde(rename = "box")]
    edges: [f64; 4],
}

impl PictureObjects {
    /// Reads the objects from a sample's label and from the answer to the sample, which is JSON with the key
    /// `detections`. Boxes are returned as fractions of the picture, because a transform may have resized the labelled
    /// picture before it reached the model. The names of classes are normalised, so that they can be compared. Returns
    /// `None` if the label does not describe objects or the answer is something else.
    pub fn read(label: &str, answer: &[u8]) -> Option<Self> {
        let label = ObjectsLabel::parse(label)?;
        let answer: Answer = serde_json::from_slice(answer).ok()?;
        let object = |class: &str, [left, top, right, bottom]: [f64; 4], width: f64, height: f64| ObjectBox {
            class: normalized_label(class),
            edges: [left / width, top / height, right / width, bottom / height],
        };
        let (width, height) = (label.width.into(), label.height.into());
        let labelled = label.objects.iter();
        let labelled = labelled.map(|labelled_object| {
            object(&labelled_object.label, labelled_object.edges.map(f64::from), width, height)
        });
        let found = answer.detections.iter();
        let found = found.map(|detection| {
            (object(&detection.label, detection.edges, answer.width, answer.height), detection.score)
        });
        Some(Self { labelled: labelled.collect(), found: found.collect() })
    }
}

/// Scores of a detector over one or several pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectionScores {
    /// Mean of the average precisions of all classes at an overlap of [`MATCHING_IOU`], from 0 to 1. A class that is found but
    /// not labelled has an average precision of 0. The mean is 1 if nothing is labelled and nothing is found.
    pub map_50: f64,
    /// Mean overlap of the labelled objects that were found, from [`MATCHING_IOU`] to 1; `None` if no labelled object
    /// was found.
    pub mean_iou: Option<f64>,
    /// Number of labelled objects.
    pub labelled: u64,
    /// Number of labelled objects that were found. Found boxes without a labelled object at their place do not count.
    pub matched: u64,
}

impl DetectionScores {
    /// Computes the scores over all objects of all pictures.
    pub fn of(pictures: &[PictureObjects]) -> Self {
        let classes_of = |picture: &PictureObjects| {
            let found = picture.found.iter().map(|(found, _)| &found.class);
            picture.labelled.iter().map(|object| &object.class).chain(found).cloned().collect::<Vec<_>>()
        };
        let classes: BTreeSet<String> = pictures.iter().flat_map(classes_of).collect();
        let mut overlaps = Vec::new();
        let mut precisions = 0.0;
        for class in &classes {
            precisions += average_precision(pictures, class, &mut overlaps);
        }
        let map_50 = if classes.is_empty() { 1.0 } else { precisions / classes.len() as f64 };
        let matched = overlaps.len() as u64;
        let mean_iou = (matched > 0).then(|| overlaps.iter().sum::<f64>() / matched as f64);
        let labelled = pictures.iter().map(|picture| picture.labelled.len() as u64).sum();
        Self { map_50, mean_iou, labelled, matched }
    }
}

/// Returns the average precision of a class. Adds to `overlaps` the overlap of each labelled object of this class that
/// was found.
fn average_precision(pictures: &[PictureObjects], class: &str, overlaps: &mut Vec<f64>) -> f64 {
    let labelled = pictures.iter().flat_map(|picture| &picture.labelled);
    let labelled = labelled.filter(|object| object.class == class).count();
    // Picture, box and score of each found object, best score first. The sort is stable: objects with equal scores keep
    // the order of the answers.
    let mut found_boxes: Vec<(usize, &ObjectBox, f64)> = Vec::new();
    for (index, picture) in pictures.iter().enumerate() {
        let of_class = picture.found.iter().filter(|(object, _)| object.class == class);
        found_boxes.extend(of_class.map(|(object, score)| (index, object, *score)));
    }
    found_boxes.sort_by(|(.., a), (.., b)| b.total_cmp(a));
    // Indexes of the matched labelled objects of each picture. Each labelled object can be found once. A second box at
    // the place of the object is wrong.
    let mut matched_by_picture: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
    let mut are_right = Vec::with_capacity(found_boxes.len());
    for (picture, found, _) in found_boxes {
        let matched = matched_by_picture.entry(picture).or_default();
        let candidates = pictures[picture].labelled.iter().enumerate();
        let candidates = candidates.filter(|(index, label)| label.class == class && !matched.contains(index));
        let overlap = candidates.map(|(index, label)| (index, iou(label.edges, found.edges)));
        let best = overlap.max_by(|(_, a), (_, b)| a.total_cmp(b)).filter(|(_, iou)| *iou >= MATCHING_IOU);
        are_right.push(best.is_some());
        if let Some((index, overlap)) = best {
            matched.insert(index);
            overlaps.push(overlap);
        }
    }
    area_under_curve(&are_right, labelled)
}

/// Returns the area under the curve of precision over recall. `are_right` has an item for each found box, best score
/// first: whether the box is at the place of a labelled object. `labelled` is the number of labelled objects.
fn area_under_curve(are_right: &[bool], labelled: usize) -> f64 {
    if labelled == 0 {
        return 0.0;
    }
    let mut right = 0_usize;
    let mut precisions = Vec::new();
    for (index, is_right) in are_right.iter().enumerate() {
        if *is_right {
            right += 1;
            precisions.push(right as f64 / (index + 1) as f64);
        }
    }
    // The sum runs from the highest recall to the lowest with the largest precision so far. Each right box raises the
    // recall by the same step.
    let mut largest = 0.0_f64;
    let mut area = 0.0;
    for precision in precisions.into_iter().rev() {
        largest = largest.max(precision);
        area += largest;
    }
    area / labelled as f64
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn object(class: &str, left: f64) -> ObjectBox {
        ObjectBox { class: class.to_owned(), edges: [left, 0.0, left + 10.0, 10.0] }
    }

    fn picture(labelled: &[(&str, f64)], found: &[(&str, f64, f64)]) -> PictureObjects {
        PictureObjects {
            labelled: labelled.iter().map(|(class, left)| object(class, *left)).collect(),
            found: found.iter().map(|(class, left, score)| (object(class, *left), *score)).collect(),
        }
    }

    #[test]
    fn resized_picture_is_compared_in_fractions() {
        let label =
            r#"{"objects": [{"label": "Hole_Missing", "box": [0, 0, 10, 10]}], "width": 10, "height": 10}"#;
        let answer = br#"{"detections": [{"label": "hole missing", "score": 0.5, "box": [0, 0, 5, 20]}], "width": 5, "height": 20}"#;
        let whole = ObjectBox { class: "hole missing".to_owned(), edges: [0.0, 0.0, 1.0, 1.0] };
        let expected = PictureObjects { labelled: vec![whole.clone()], found: vec![(whole, 0.5)] };
        assert_eq!(PictureObjects::read(label, answer), Some(expected));
        assert_eq!(PictureObjects::read("good", answer), None);
        assert_eq!(PictureObjects::read(label, br#"{"label": "good", "top": []}"#), None);
    }

    #[test]
    fn exact_boxes_have_full_precision() {
        let exact = picture(&[("a", 0.0), ("b", 50.0)], &[("b", 50.0, 0.4), ("a", 0.0, 0.9)]);
        let scores = DetectionScores::of(&[exact]);
        assert_eq!(scores, DetectionScores { map_50: 1.0, mean_iou: Some(1.0), labelled: 2, matched: 2 });
    }

    #[test]
    fn area_uses_largest_precision_at_higher_recall() {
        // Precisions at the right boxes: 1/1, 2/3, 3/4, of four labelled objects: (1 + 3/4 + 3/4) / 4.
        assert_eq!(area_under_curve(&[true, false, true, true, false], 4), 2.5 / 4.0);
        assert_eq!([area_under_curve(&[], 3), area_under_curve(&[false], 0)], [0.0, 0.0]);
    }

    #[test]
    fn boxes_of_all_pictures_are_ranked_together() {
        // The wrong box of the second picture has the higher score. The precision at the only right box is therefore
        // 1/2.
        let first = picture(&[("a", 0.0)], &[("a", 0.0, 0.5)]);
        let second = picture(&[], &[("a", 0.0, 0.9)]);
        assert_eq!(DetectionScores::of(&[first.clone(), second]).map_50, 0.5);
        let weaker = picture(&[], &[("a", 0.0, 0.1)]);
        assert_eq!(DetectionScores::of(&[first, weaker]).map_50, 1.0);
    }

    #[test]
    fn second_box_of_one_object_is_wrong() {
        let twice =
            picture(&[("a", 0.0), ("a", 100.0)], &[("a", 0.0, 0.9), ("a", 1.0, 0.8), ("a", 100.0, 0.7)]);
        // Precisions 1/1 and 2/3 of two objects.
        let scores = DetectionScores::of(&[twice]);
        assert!((scores.map_50 - (1.0 + 2.0 / 3.0) / 2.0).abs() < 1e-12, "{scores:?}");
        assert_eq!((scores.labelled, scores.matched), (2, 2));
    }

    #[test]
    fn box_of_wrong_place_or_class_is_not_matched() {
        // The third box overlaps, but by 6/14 only, which is less than `MATCHING_IOU`.
        for found in [("a", 20.0, 0.9), ("b", 0.0, 0.9), ("a", 4.0, 0.9)] {
            let scores = DetectionScores::of(&[picture(&[("a", 0.0)], &[found])]);
            assert_eq!((scores.map_50, scores.mean_iou, scores.matched), (0.0, None, 0), "{found:?}");
        }
        let near = DetectionScores::of(&[picture(&[("a", 0.0)], &[("a", 2.5, 0.9)])]);
        assert_eq!((near.map_50, near.mean_iou), (1.0, Some(0.6)));
    }

    #[test]
    fn empty_picture_without_found_boxes_scores_one() {
        assert_eq!(DetectionScores::of(&[PictureObjects::default()]).map_50, 1.0);
        assert_eq!(DetectionScores::of(&[picture(&[], &[("a", 0.0, 0.3)])]).map_50, 0.0);
    }

    proptest! {
        #[test]
        fn scores_are_between_zero_and_one(labelled in proptest::collection::vec((0u8..2, 0u8..40), 0..8),
                             found in proptest::collection::vec((0u8..2, 0u8..40, 0u8..9), 0..12)) {
            let name = |class: u8| if class == 0 { "a" } else { "b" };
            let labelled: Vec<_> = labelled.iter().map(|(class, left)| (name(*class), f64::from(*left))).collect();
            let found: Vec<_> =
                found.iter().map(|(class, left, score)| (name(*class), f64::from(*left), f64::from(*score))).collect();
            let scores = DetectionScores::of(&[picture(&labelled, &found)]);
            prop_assert!((0.0..=1.0).contains(&scores.map_50));
            prop_assert!(scores.mean_iou.is_none_or(|iou| (MATCHING_IOU..=1.0).contains(&iou)));
            prop_assert!(scores.matched <= scores.labelled);
        }
    }
}
