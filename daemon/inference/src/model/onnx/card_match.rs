//! Comparison of a card with the names, types and shapes that the model declares for its inputs and outputs. The crate
//! `ort` calls an input or output an [`Outlet`].

use ort::value::{Outlet, TensorElementType, ValueType};

use super::card::{Card, Detection, DetectionOutputs, Input, Source, Task};
use super::data_type::DataType;
use super::outputs::is_float;

/// Reason why a card does not fit its model.
#[derive(Debug, PartialEq, thiserror::Error)]
pub(super) enum MismatchError {
    /// The model has no input or output of that name. In this and the next variant, `kind` is `input` or `output`.
    #[error("its card names the {kind} {name:?}, but it has {}", .names.join(", "))]
    Name { kind: &'static str, name: String, names: Vec<String> },
    /// Type or shape differ.
    #[error("its {kind} {name:?} is {actual}, its card says {expected}")]
    Form { kind: &'static str, name: String, actual: String, expected: String },
    /// The model has an input that the card does not name.
    #[error(
        "it has the input {0:?}, which its card does not name; add an [[input]], with `value` if it is a constant"
    )]
    UnnamedInput(String),
    /// The model takes a fixed number of samples, so that it cannot compute batches.
    #[error(
        "its input {0:?} takes one sample at a time; remove `batch`, or export the model with an open first dimension \
         (dynamic_axes) and let the shape in the card begin with 1, the length of that dimension for one sample"
    )]
    FixedBatch(String),
}

/// Types that the elements of an input or output may have.
#[derive(Clone, Copy)]
enum ElementTypes {
    /// One type.
    Exactly(DataType),
    /// Any float.
    Floats,
    /// Any type that cards can name.
    Any,
}

/// Required length of a dimension; `None` if any length fits.
type Length = Option<usize>;

/// Returns whether the model takes any number of samples along the first dimension of an input.
pub(super) fn has_open_batch(input: &Input, outlets: &[Outlet]) -> bool {
    let outlet = outlets.iter().find(|outlet| outlet.name() == input.name);
    let length = outlet.and_then(|outlet| outlet.dtype().tensor_shape()?.first().copied());
    // The shape in the card is that of one sample, so a dimension of the batch has the length 1 there.
    input.shape.first() == Some(&1) && length.is_some_and(|length| length < 0)
}

/// Checks that all inputs that samples fill have an open batch dimension.
pub(super) fn check_batch(card: &Card, outlets: &[Outlet]) -> Result<(), MismatchError> {
    let filled = card.inputs.iter().filter(|input| !matches!(input.source, Source::Constant(_)));
    match filled.into_iter().find(|input| !has_open_batch(input, outlets)) {
        Some(input) => Err(MismatchError::FixedBatch(input.name.clone())),
        None => Ok(()),
    }
}

/// Checks that the model has the inputs and outputs of the card, and no further inputs.
pub(super) fn check(card: &Card, inputs: &[Outlet], outputs: &[Outlet]) -> Result<(), MismatchError> {
    for input in &card.inputs {
        let shape: Vec<Length> = input.shape.iter().copied().map(Some).collect();
        check_outlet("input", inputs, &input.name, ElementTypes::Exactly(input.data_type), &[&shape])?;
    }
    let is_named = |outlet: &&Outlet| card.inputs.iter().any(|input| input.name == outlet.name());
    if let Some(outlet) = inputs.iter().find(|outlet| !is_named(outlet)) {
        return Err(MismatchError::UnnamedInput(outlet.name().to_owned()));
    }
    check_outputs(&card.task, outputs)
}

fn check_outputs(task: &Task, outlets: &[Outlet]) -> Result<(), MismatchError> {
    let check =
        |name: &str, elements, shapes: &[&[Length]]| check_outlet("output", outlets, name, elements, shapes);
    // The dimension of the batch has the length 1. It may be missing where the other dimensions are unambiguous.
    let one = Some(1);
    match task {
        Task::Classification(task) => check_with_labels(task.labels.len(), |classes| {
            check(&task.name, ElementTypes::Floats, &[&[one, classes], &[classes]])
        }),
        Task::Detection(task) => check_detection(task, &check),
        Task::Segmentation(task) => {
            // Floats are scores, other numbers are classes. The first inference checks whether the shape fits the type.
            check_with_labels(task.labels.len(), |classes| {
                let scores = [one, classes, None, None];
                check(&task.name, ElementTypes::Any, &[&scores, &[one, None, None], &[one, one, None, None]])
            })
        }
        Task::Embedding(task) => check(&task.name, ElementTypes::Floats, &[&[one, None], &[None]]),
        Task::Tensors(tensors) => tensors.iter().try_for_each(|tensor| {
            let shape: Vec<Length> = tensor.shape.iter().copied().map(Some).collect();
            check(&tensor.name, ElementTypes::Exactly(tensor.data_type), &[&shape])
        }),
    }
}

fn check_detection(
    task: &Detection,
    check: &impl Fn(&str, ElementTypes, &[&[Length]]) -> Result<(), MismatchError>,
) -> Result<(), MismatchError> {
    let (one, four, labels) = (Some(1), Some(4), task.labels.len());
    match &task.outputs {
        // Each candidate has four coordinates, an objectness, and a score for each class.
        DetectionOutputs::Yolov5 { name, .. } => check_with_labels(labels, |classes| {
            check(name, ElementTypes::Floats, &[&[one, None, classes.map(|classes| 5 + classes)]])
        }),
        // Each candidate is a column: four coordinates and a score for each class, without an objectness.
        DetectionOutputs::Yolov8 { name, .. } => check_with_labels(labels, |classes| {
            check(name, ElementTypes::Floats, &[&[one, classes.map(|classes| 4 + classes), None]])
        }),
        // Each candidate has four coordinates, the score and the number of the class, so the shape does not depend on
        // the number of labels.
        DetectionOutputs::Yolov10 { name } => check(name, ElementTypes::Floats, &[&[one, None, Some(6)]]),
        DetectionOutputs::Detr { scores, boxes, is_softmax } => {
            check_with_labels(labels, |classes| {
                // With softmax, the last logit means "no object".
                let logits = classes.map(|classes| classes + usize::from(*is_softmax));
                check(scores, ElementTypes::Floats, &[&[one, None, logits]])
            })?;
            check(boxes, ElementTypes::Floats, &[&[one, None, four]])
        }
        DetectionOutputs::Nms { boxes, scores, classes, count } => {
            check(boxes, ElementTypes::Floats, &[&[one, None, four], &[None, four]])?;
            check(scores, ElementTypes::Floats, &[&[one, None], &[None]])?;
            check(classes, ElementTypes::Any, &[&[one, None], &[None]])?;
            match count {
                Some(count) => check(count, ElementTypes::Any, &[&[one, one], &[one], &[]]),
                None => Ok(()),
            }
        }
    }
}

/// Checks an output with a length that depends on the number of labels. If only this length does not fit, the error
/// names `labels`: the card states the length by its labels and not by a shape.
fn check_with_labels(
    labels: usize,
    check: impl Fn(Length) -> Result<(), MismatchError>,
) -> Result<(), MismatchError> {
    check(Some(labels)).map_err(|mismatch| match mismatch {
        MismatchError::Form { kind, name, actual, expected } if check(None).is_ok() => {
            let expected = format!("{expected}, because `labels` has {labels}; write a label for each class");
            MismatchError::Form { kind, name, actual, expected }
        }
        other => other,
    })
}

/// Checks that there is an input or output with this name, these types of elements and one of these shapes.
fn check_outlet(
    kind: &'static str,
    outlets: &[Outlet],
    name: &str,
    elements: ElementTypes,
    shapes: &[&[Length]],
) -> Result<(), MismatchError> {
    let name = name.to_owned();
    let Some(outlet) = outlets.iter().find(|outlet| outlet.name() == name) else {
        let names = outlets.iter().map(|outlet| format!("{:?}", outlet.name())).collect();
        return Err(MismatchError::Name { kind, name, names });
    };
    let dtype = outlet.dtype();
    let fits_any_shape = |actual: &[i64]| {
        // A shape that the model does not declare appears to have no dimension. The first inference then checks the
        // shape.
        actual.is_empty() || shapes.iter().any(|shape| shape_fits(actual, shape))
    };
    if dtype.tensor_type().is_some_and(|onnx| elements.contains(onnx))
        && dtype.tensor_shape().is_some_and(|shape| fits_any_shape(shape))
    {
        return Ok(());
    }
    let shapes: Vec<String> = shapes.iter().map(|shape| describe_shape(shape)).collect();
    let expected = format!("{} of shape {}", elements.describe(), shapes.join(" or "));
    Err(MismatchError::Form { kind, name, actual: describe_type(dtype), expected })
}

/// Returns the type and the shape of an input or output as a card writes them: `float32 of shape [1, 3, n, n]`.
fn describe_type(dtype: &ValueType) -> String {
    let (Some(onnx), Some(shape)) = (dtype.tensor_type(), dtype.tensor_shape()) else {
        return dtype.to_string();
    };
    let elements = DataType::from_onnx(onnx).map_or_else(|| onnx.to_string(), |known| known.to_string());
    let shape: Vec<Length> = shape.iter().map(|length| usize::try_from(*length).ok()).collect();
    format!("{elements} of shape {}", describe_shape(&shape))
}

/// Returns whether a declared shape fits; a declared length of -1 is open and fits any length.
fn shape_fits(actual: &[i64], shape: &[Length]) -> bool {
    let length_fits = |(actual, length): (&i64, &Length)| {
        *actual < 0 || length.is_none_or(|length| i64::try_from(length) == Ok(*actual))
    };
    actual.len() == shape.len() && actual.iter().zip(shape).all(length_fits)
}

/// Formats a shape: `[1, 84, n]`.
fn describe_shape(shape: &[Length]) -> String {
    let length = |length: &Length| length.map_or_else(|| "n".to_owned(), |length| length.to_string());
    format!("[{}]", shape.iter().map(length).collect::<Vec<_>>().join(", "))
}

impl ElementTypes {
    fn contains(self, onnx: TensorElementType) -> bool {
        match self {
            Self::Exactly(data_type) => DataType::from_onnx(onnx) == Some(data_type),
            Self::Floats => is_float(onnx),
            Self::Any => DataType::from_onnx(onnx).is_some(),
        }
    }

    fn describe(self) -> String {
        match self {
            Self::Exactly(data_type) => data_type.to_string(),
            Self::Floats => "float32, float16 or float64".to_owned(),
            Self::Any => "numbers".to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn open_lengths_fit_any_length() {
        for (actual, shape, is_fitting) in [
            (&[1, 4][..], &[Some(1), Some(4)][..], true),
            (&[-1, 4], &[Some(1), Some(4)], true),
            (&[1, 4], &[Some(1), None], true),
            (&[1, 5], &[Some(1), Some(4)], false),
            (&[4], &[Some(1), Some(4)], false),
            (&[], &[], true),
        ] {
            assert_eq!(shape_fits(actual, shape), is_fitting, "{actual:?} {shape:?}");
        }
        assert_eq!(describe_shape(&[Some(1), None]), "[1, n]");
    }
}
