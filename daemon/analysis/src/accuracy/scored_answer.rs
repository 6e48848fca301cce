//! Comparison of an answer with the label of its sample.

use std::path::Path;

use peernet_logger::{Tree, stage};
use peernet_sample::{MaskLabel, ObjectsLabel, Part, Sample, normalized_label};
use serde::Deserialize;

use super::detection::PictureObjects;
use super::segmentation::{ClassMap, SegmentedPixels};

/// Number of best classes that `top-5` considers.
const TOP_5_CLASSES: usize = 5;

/// Answer that was compared with the label of its sample.
#[derive(Clone, Debug, PartialEq)]
pub enum ScoredAnswer {
    /// The label, or a class of its mask, is not a class of the model. No answer to such a sample can be right, so the
    /// answer says nothing about the accuracy of the model.
    UnknownLabel,
    /// Classification.
    Class {
        /// Whether the best class of the answer is the label.
        is_best: bool,
        /// Whether the label is among the best five classes; `None` if the answer has fewer classes.
        is_in_top: Option<bool>,
    },
    /// Labelled and found objects of a detection.
    Objects(PictureObjects),
    /// Labelled and answered pixels of a segmentation.
    Pixels(SegmentedPixels),
}

/// Keys that are read from a classifier's answer.
#[derive(Deserialize)]
struct Classification {
    label: String,
    /// Classes, best first.
    top: Option<Vec<Class>>,
}

#[derive(Deserialize)]
struct Class {
    label: String,
}

impl ScoredAnswer {
    /// Compares an answer with the label of its sample. The label determines what the answer should be:
    ///
    /// - a mask, which `read_mask` reads from its file: a segmentation, which is JSON and grey pixels
    /// - objects: a detection, which is JSON with `detections`
    /// - a class: a classification, which is JSON with `label` and, best first, `top`
    ///
    /// `measurements` are those of the answer; in them the model marks a label that is not one of its classes. Returns
    /// `None` if the answer has another form.
    ///
    /// # Errors
    /// The error of `read_mask`.
    pub fn of<E>(
        label: &str,
        answer: &Sample,
        measurements: &Tree,
        read_mask: impl FnOnce(&Path) -> Result<Part, E>,
    ) -> Result<Option<Self>, E> {
        if measurements.find(&[&stage::UNKNOWN_LABEL]).is_some() {
            return Ok(Some(Self::UnknownLabel));
        }
        if let Some(label) = MaskLabel::parse(label) {
            let Some(classes) = ClassMap::from_answer(answer) else { return Ok(None) };
            let mask = read_mask(Path::new(&label.mask))?;
            // The model does not receive the mask, so the model cannot mark a class as unknown itself.
            let scored = |mask: ClassMap<'_>| match mask.has_unknown_class(answer) {
                true => Self::UnknownLabel,
                false => Self::Pixels(SegmentedPixels::of(mask, classes)),
            };
            return Ok(ClassMap::from_part(&mask).map(scored));
        }
        let Some(json) = answer.json() else { return Ok(None) };
        if ObjectsLabel::parse(label).is_some() {
            return Ok(PictureObjects::read(label, json).map(Self::Objects));
        }
        Ok(serde_json::from_slice(json).ok().map(|classification| Self::of_class(label, classification)))
    }

    fn of_class(label: &str, Classification { label: best, top }: Classification) -> Self {
        // A label is often the name of a folder, which may be spelled differently from the model's class.
        let label = normalized_label(label);
        let matches_label = |class: &str| normalized_label(class) == label;
        let is_best = matches_label(&best);
        // If the list has fewer than five classes, the label might be in the list only because the model has so few
        // classes. A list in another order must not make `top-5` lower than `top-1`.
        let is_in_top = top
            .filter(|top| top.len() >= TOP_5_CLASSES)
            .map(|top| is_best || top.iter().take(TOP_5_CLASSES).any(|class| matches_label(&class.label)));
        Self::Class { is_best, is_in_top }
    }
}
