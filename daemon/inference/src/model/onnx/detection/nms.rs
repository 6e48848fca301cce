//! Boxes, their overlap, and the suppression of boxes that show the same object.

use peernet_sample::iou;

/// Rectangle along the axes, in pixels of the model's input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::model::onnx) struct Rectangle {
    pub(super) left: f32,
    pub(super) top: f32,
    pub(super) right: f32,
    pub(super) bottom: f32,
}

/// A box that may show an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::model::onnx) struct Candidate {
    pub(super) class: usize,
    pub(super) score: f32,
    pub(super) rectangle: Rectangle,
}

impl Rectangle {
    /// Returns the [`iou`] of two rectangles.
    pub(super) fn overlap(self, other: Self) -> f64 {
        let edges = |Self { left, top, right, bottom }: Self| [left, top, right, bottom].map(f64::from);
        iou(edges(self), edges(other))
    }
}

/// Sorts candidates by score and keeps the best ones, at most `max_kept`. A candidate is dropped if its overlap with a
/// kept candidate of the same class is above `iou_threshold` (greedy non-maximum suppression, as torchvision's
/// `batched_nms`).
pub(super) fn keep_best(candidates: &mut Vec<Candidate>, iou_threshold: Option<f64>, max_kept: usize) {
    // The sort is stable: candidates with equal scores stay in the order of the model.
    candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
    if let Some(threshold) = iou_threshold {
        let mut kept: Vec<Candidate> = Vec::with_capacity(max_kept.min(candidates.len()));
        // Each candidate is compared only with the kept candidates, of which there are at most `max_kept`. Even a noisy
        // output therefore takes bounded time.
        for candidate in candidates.iter() {
            if kept.len() == max_kept {
                break;
            }
            let is_same_object = |other: &Candidate| {
                other.class == candidate.class && other.rectangle.overlap(candidate.rectangle) > threshold
            };
            if !kept.iter().any(is_same_object) {
                kept.push(*candidate);
            }
        }
        *candidates = kept;
    }
    candidates.truncate(max_kept);
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn candidate(class: usize, score: f32, left: f32) -> Candidate {
        let rectangle = Rectangle { left, top: 0.0, right: left + 10.0, bottom: 10.0 };
        Candidate { class, score, rectangle }
    }

    #[test]
    fn overlap_is_intersection_over_union() {
        let overlap = |left: f32| candidate(0, 1.0, 0.0).rectangle.overlap(candidate(0, 1.0, left).rectangle);
        assert_eq!([overlap(0.0), overlap(10.0), overlap(20.0)], [1.0, 0.0, 0.0]);
        assert!((overlap(5.0) - 1.0 / 3.0).abs() < 1e-6);
        let empty = Rectangle { left: 1.0, top: 1.0, right: 1.0, bottom: 1.0 };
        assert_eq!(empty.overlap(empty), 0.0);
    }

    #[test]
    fn weaker_box_of_same_class_is_dropped() {
        let all =
            [candidate(0, 0.5, 1.0), candidate(0, 0.9, 0.0), candidate(1, 0.4, 1.0), candidate(0, 0.3, 9.0)];
        let kept = |iou, max_kept| {
            let mut candidates = all.to_vec();
            keep_best(&mut candidates, iou, max_kept);
            candidates.iter().map(|kept| kept.score).collect::<Vec<_>>()
        };
        assert_eq!(kept(Some(0.5), 10), [0.9, 0.4, 0.3]);
        assert_eq!(kept(None, 10), [0.9, 0.5, 0.4, 0.3]);
        assert_eq!(kept(Some(0.5), 2), [0.9, 0.4]);
        assert_eq!(kept(None, 1), [0.9]);
    }

    proptest! {
        #[test]
        fn kept_boxes_do_not_overlap(boxes in proptest::collection::vec((0usize..3, 0u8..100, 0u8..60), 0..60)) {
            let all: Vec<_> =
                boxes.iter().map(|(class, score, left)| candidate(*class, f32::from(*score), f32::from(*left))).collect();
            let mut kept = all.clone();
            keep_best(&mut kept, Some(0.4), 100);
            for (index, a) in kept.iter().enumerate() {
                for b in &kept[index + 1..] {
                    prop_assert!(a.score >= b.score);
                    prop_assert!(a.class != b.class || a.rectangle.overlap(b.rectangle) <= 0.4);
                }
            }
            for dropped in all.iter().filter(|candidate| !kept.contains(candidate)) {
                let better = |other: &&Candidate| other.class == dropped.class
                    && other.score >= dropped.score
                    && other.rectangle.overlap(dropped.rectangle) > 0.4;
                prop_assert!(kept.iter().any(|other| better(&other)));
            }
        }
    }
}
