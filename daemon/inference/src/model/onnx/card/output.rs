//! The table `[output]` of a card: the conversion of the model's outputs to an answer.

use std::collections::HashSet;

use serde::Deserialize;

use super::ModelCardError;
use super::input::lengths;
use crate::model::onnx::data_type::DataType;

/// Default number of classes that an answer lists.
const DEFAULT_TOP_K: usize = 5;

/// Maximum number of classes of a segmentation: the class of a pixel is one byte.
const MAX_SEGMENTATION_CLASSES: usize = 256;

/// Output of a classifier.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::model::onnx) struct Classification {
    /// Name of the model's output.
    pub(in crate::model::onnx) name: String,
    #[serde(default)]
    pub(in crate::model::onnx) activation: Activation,
    /// Number of classes that an answer lists, best first. Default: five, or all classes if there are fewer.
    #[serde(default)]
    pub(in crate::model::onnx) top_k: Option<usize>,
    /// One label for each number of the output.
    pub(in crate::model::onnx) labels: Vec<String>,
}

/// Function that turns the model's numbers into scores.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(in crate::model::onnx) enum Activation {
    /// No function: the numbers are scores already.
    #[default]
    None,
    /// Softmax: the scores add up to 1. For models with exactly one right class for each sample.
    Softmax,
    /// Sigmoid: each score is between 0 and 1, independent of the others. For models with any number of right classes
    /// for each sample.
    Sigmoid,
}

/// Output of a model that answers with a vector.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::model::onnx) struct Embedding {
    /// Name of the model's output.
    pub(in crate::model::onnx) name: String,
    /// `true` to divide the vector by its Euclidean length.
    #[serde(default)]
    pub(in crate::model::onnx) normalise: bool,
}

/// Output of a model that gives each pixel a class.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::model::onnx) struct Segmentation {
    /// Name of the model's output.
    pub(in crate::model::onnx) name: String,
    /// One label per class, at most 256.
    pub(in crate::model::onnx) labels: Vec<String>,
}

/// An output that the answer contains unchanged.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::model::onnx) struct TensorOutput {
    /// Name of the model's output.
    pub(in crate::model::onnx) name: String,
    #[serde(rename = "dtype")]
    pub(in crate::model::onnx) data_type: DataType,
    /// Lengths of the dimensions, each larger than 0.
    #[serde(deserialize_with = "lengths")]
    pub(in crate::model::onnx) shape: Vec<usize>,
}

impl Classification {
    /// Returns the number of classes that an answer lists.
    pub(in crate::model::onnx) fn listed_class_count(&self) -> usize {
        self.top_k.unwrap_or(DEFAULT_TOP_K).min(self.labels.len())
    }

    pub(super) fn check(&self) -> Result<(), ModelCardError> {
        check_labels(&self.labels)?;
        match self.top_k {
            Some(0) => Err(ModelCardError::NoListedClass),
            Some(top_k) if top_k > self.labels.len() => {
                Err(ModelCardError::TopK { top_k, classes: self.labels.len() })
            }
            _ => Ok(()),
        }
    }
}

impl Segmentation {
    pub(super) fn check(&self) -> Result<(), ModelCardError> {
        check_labels(&self.labels)?;
        match self.labels.len() {
            count if count > MAX_SEGMENTATION_CLASSES => Err(ModelCardError::TooManyClasses(count)),
            _ => Ok(()),
        }
    }
}

/// Checks the outputs of the task `tensors`.
pub(super) fn check_tensors(outputs: &[TensorOutput]) -> Result<(), ModelCardError> {
    if outputs.is_empty() {
        return Err(ModelCardError::NoOutput);
    }
    let mut names = HashSet::new();
    match outputs.iter().find(|output| !names.insert(&output.name)) {
        Some(output) => Err(ModelCardError::DuplicateName { table: "output", name: output.name.clone() }),
        None => Ok(()),
    }
}

/// Checks that there are labels and that all differ.
pub(super) fn check_labels(labels: &[String]) -> Result<(), ModelCardError> {
    if labels.is_empty() {
        return Err(ModelCardError::NoLabels);
    }
    // Labels that differ in case alone are allowed: ImageNet has `cardigan`, a garment, and `Cardigan`, a dog.
    let mut seen = HashSet::new();
    match labels.iter().find(|label| !seen.insert(label.as_str())) {
        Some(label) => Err(ModelCardError::DuplicateLabel(label.clone())),
        None => Ok(()),
    }
}
