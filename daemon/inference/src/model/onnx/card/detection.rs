//! The table `[output]` of a detector.

use serde::Deserialize;

use super::ModelCardError;
use super::output::{Activation, check_labels};

/// Default of `score_threshold`: objects with a higher score are reported.
// This default and the next one are those of YOLOv5's `detect.py`.
const DEFAULT_SCORE_THRESHOLD: f64 = 0.25;

/// Default of `iou_threshold` for models that do not suppress overlapping boxes themselves.
const DEFAULT_IOU_THRESHOLD: f64 = 0.45;

/// Default of `max_detections`.
const DEFAULT_MAX_DETECTIONS: usize = 100;

/// Largest permitted value of `max_detections`.
const MAX_MAX_DETECTIONS: usize = 10_000;

/// Outputs of a detector and their conversion to boxes.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::model::onnx) struct Detection {
    pub(in crate::model::onnx) outputs: DetectionOutputs,
    pub(in crate::model::onnx) box_format: BoxFormat,
    pub(in crate::model::onnx) box_unit: BoxUnit,
    /// One label per class, in the order of the classes' numbers.
    pub(in crate::model::onnx) labels: Vec<String>,
    /// Objects with a higher score are reported.
    pub(in crate::model::onnx) score_threshold: f32,
    /// If two boxes of one class have a higher ratio of intersection to union, the box with the lower score is dropped.
    /// `None`: all boxes are kept.
    pub(in crate::model::onnx) iou_threshold: Option<f64>,
    /// Maximum number of objects in an answer. Objects with the highest scores are reported.
    pub(in crate::model::onnx) max_detections: usize,
}

/// Outputs of the model, with their names. `n` is the number of candidates.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::model::onnx) enum DetectionOutputs {
    /// One output, `[1, n, 5 + classes]`: box, score that the box contains an object, scores of the classes (YOLOv5,
    /// YOLOv7, YOLOX).
    Yolov5 { name: String, activation: Activation },
    /// One output, `[1, 4 + classes, n]`: box, scores of the classes (YOLOv8 and later).
    Yolov8 { name: String, activation: Activation },
    /// One output, `[1, n, 6]`: box, score, number of the class (YOLOv10, exports with suppression).
    Yolov10 { name: String },
    /// Two outputs, logits and boxes `[1, n, 4]`. With softmax, the logits are `[1, n, classes + 1]`, and the last one
    /// means "no object" (DETR); with sigmoid, they are `[1, n, classes]` (Deformable DETR, RT-DETR).
    Detr { scores: String, boxes: String, is_softmax: bool },
    /// Boxes `[n, 4]`, scores `[n]` and numbers of classes `[n]`, each optionally with a first dimension of length 1
    /// for the batch; optionally, a fourth output has the number of valid candidates. For models that contain the
    /// suppression.
    Nms { boxes: String, scores: String, classes: String, count: Option<String> },
}

/// Meaning of the four numbers of a box.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(in crate::model::onnx) enum BoxFormat {
    /// Centre x, centre y, width, height.
    Cxcywh,
    /// Left, top, right, bottom.
    Xyxy,
    /// Left, top, width, height.
    Xywh,
    /// Top, left, bottom, right.
    Yxyx,
}

/// Unit of the four numbers of a box.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(in crate::model::onnx) enum BoxUnit {
    /// Pixels of the input.
    Pixels,
    /// Fractions of the input's width and height.
    Fraction,
}

impl DetectionOutputs {
    /// Returns the name of the output with the scores.
    pub(in crate::model::onnx) fn scores(&self) -> &str {
        match self {
            Self::Yolov5 { name, .. } | Self::Yolov8 { name, .. } | Self::Yolov10 { name } => name,
            Self::Detr { scores, .. } | Self::Nms { scores, .. } => scores,
        }
    }

    /// Returns the name of the layout in cards.
    pub(in crate::model::onnx) const fn layout(&self) -> &'static str {
        match self {
            Self::Yolov5 { .. } => Layout::Yolov5.name(),
            Self::Yolov8 { .. } => Layout::Yolov8.name(),
            Self::Yolov10 { .. } => Layout::Yolov10.name(),
            Self::Detr { .. } => Layout::Detr.name(),
            Self::Nms { .. } => Layout::Nms.name(),
        }
    }
}

/// Layout of a detector's outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Layout {
    Yolov5,
    Yolov8,
    Yolov10,
    Detr,
    Nms,
}

/// The table `[output]` as written in the card.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DetectionTable {
    layout: Layout,
    name: Option<String>,
    boxes: Option<String>,
    scores: Option<String>,
    classes: Option<String>,
    count: Option<String>,
    activation: Option<Activation>,
    box_format: Option<BoxFormat>,
    box_unit: Option<BoxUnit>,
    labels: Vec<String>,
    #[serde(default = "default_score_threshold")]
    score_threshold: f64,
    iou_threshold: Option<f64>,
    #[serde(default = "default_max_detections")]
    max_detections: usize,
}

const fn default_score_threshold() -> f64 {
    DEFAULT_SCORE_THRESHOLD
}

const fn default_max_detections() -> usize {
    DEFAULT_MAX_DETECTIONS
}

impl Layout {
    const fn name(self) -> &'static str {
        match self {
            Self::Yolov5 => "yolov5",
            Self::Yolov8 => "yolov8",
            Self::Yolov10 => "yolov10",
            Self::Detr => "detr",
            Self::Nms => "nms",
        }
    }

    /// Returns the keys that a card of this layout may have besides the keys of all layouts: names of outputs, and
    /// the activation function.
    const fn keys(self) -> &'static [&'static str] {
        match self {
            Self::Yolov5 | Self::Yolov8 => &["name", "activation"],
            Self::Yolov10 => &["name"],
            Self::Detr => &["scores", "boxes", "activation"],
            Self::Nms => &["boxes", "scores", "classes", "count"],
        }
    }
}

impl TryFrom<DetectionTable> for Detection {
    type Error = ModelCardError;

    fn try_from(table: DetectionTable) -> Result<Self, ModelCardError> {
        let layout = table.layout;
        table.check_keys()?;
        check_labels(&table.labels)?;
        let needs_suppression = matches!(layout, Layout::Yolov5 | Layout::Yolov8);
        let default_iou = needs_suppression.then_some(DEFAULT_IOU_THRESHOLD);
        let (default_format, default_unit) = match layout {
            Layout::Yolov5 | Layout::Yolov8 => (BoxFormat::Cxcywh, BoxUnit::Pixels),
            Layout::Yolov10 | Layout::Nms => (BoxFormat::Xyxy, BoxUnit::Pixels),
            Layout::Detr => (BoxFormat::Cxcywh, BoxUnit::Fraction),
        };
        let detection = Self {
            box_format: table.box_format.unwrap_or(default_format),
            box_unit: table.box_unit.unwrap_or(default_unit),
            score_threshold: table.score_threshold as f32,
            iou_threshold: table.iou_threshold.or(default_iou),
            max_detections: table.max_detections,
            labels: table.labels.clone(),
            outputs: table.into_outputs()?,
        };
        Ok(detection)
    }
}

impl DetectionTable {
    /// Checks that the table has only keys of its layout, and that its numbers are in range.
    fn check_keys(&self) -> Result<(), ModelCardError> {
        let present = [
            ("name", self.name.is_some()),
            ("boxes", self.boxes.is_some()),
            ("scores", self.scores.is_some()),
            ("classes", self.classes.is_some()),
            ("count", self.count.is_some()),
            ("activation", self.activation.is_some()),
        ];
        let (layout, keys) = (self.layout.name(), self.layout.keys());
        if let Some((key, _)) =
            present.into_iter().find(|(key, is_present)| *is_present && !keys.contains(key))
        {
            return Err(ModelCardError::SurplusKey { layout, key, expected: keys.join(", ") });
        }
        let thresholds =
            [("score_threshold", Some(self.score_threshold)), ("iou_threshold", self.iou_threshold)];
        for (key, value) in thresholds {
            if let Some(value) = value.filter(|value| !(0.0..=1.0).contains(value)) {
                return Err(ModelCardError::Threshold { key, value });
            }
        }
        if self.activation == Some(Activation::Softmax) && self.layout != Layout::Detr {
            return Err(ModelCardError::NoSoftmax(layout));
        }
        match self.max_detections {
            1..=MAX_MAX_DETECTIONS => Ok(()),
            out_of_range => Err(ModelCardError::MaxDetections(out_of_range)),
        }
    }

    fn into_outputs(self) -> Result<DetectionOutputs, ModelCardError> {
        let (layout, keys) = (self.layout.name(), self.layout.keys());
        let missing = |key| ModelCardError::MissingKey { layout, key, expected: keys.join(", ") };
        let required = |key, value: Option<String>| value.ok_or_else(|| missing(key));
        let activation = self.activation.unwrap_or_default();
        Ok(match self.layout {
            Layout::Yolov5 => DetectionOutputs::Yolov5 { name: required("name", self.name)?, activation },
            Layout::Yolov8 => DetectionOutputs::Yolov8 { name: required("name", self.name)?, activation },
            Layout::Yolov10 => DetectionOutputs::Yolov10 { name: required("name", self.name)? },
            Layout::Detr => DetectionOutputs::Detr {
                scores: required("scores", self.scores)?,
                boxes: required("boxes", self.boxes)?,
                // The number of logits depends on the activation, so the card must name one of softmax and sigmoid.
                is_softmax: match activation {
                    Activation::Softmax => true,
                    Activation::Sigmoid => false,
                    Activation::None => return Err(missing("activation")),
                },
            },
            Layout::Nms => DetectionOutputs::Nms {
                boxes: required("boxes", self.boxes)?,
                scores: required("scores", self.scores)?,
                classes: required("classes", self.classes)?,
                count: self.count,
            },
        })
    }
}
