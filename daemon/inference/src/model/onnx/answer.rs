//! The answer to a sample: the outputs of the model, converted as the task of the card requires.

use bytes::Bytes;
use peernet_sample::{Description, MediaType, Part, Sample};

use super::card::{Card, Embedding, Task, TensorOutput};
use super::classify::classify;
use super::data_type::DataType;
use super::geometry::PictureTransform;
use super::outputs::{Output, OutputError, Outputs};
use super::{detection, segment};

/// Converts the model's outputs for a sample to the answer. `transform` relates the sample's first picture to the input
/// that the picture fills.
///
/// # Errors
/// If an output contains NaN, or does not fit the card.
pub(super) fn answer(
    card: &Card,
    outputs: &Outputs<'_, '_>,
    transform: Option<&PictureTransform>,
) -> Result<Sample, OutputError> {
    let transform = transform.ok_or(OutputError::NoPicture);
    let parts = match &card.task {
        Task::Classification(task) => {
            let numbers = class_numbers(&outputs.get(&task.name)?, task.labels.len())?;
            vec![json_part(classify(task, &mut numbers.into_owned())?)]
        }
        Task::Detection(task) => vec![json_part(detection::detect(task, outputs, transform?)?)],
        Task::Segmentation(task) => segment::segment(task, outputs, transform?)?,
        Task::Embedding(task) => vec![embedding(task, &outputs.get(&task.name)?)?],
        Task::Tensors(tensors) => tensors
            .iter()
            .map(|tensor| tensor_part(&declared_output(tensor, outputs)?))
            .collect::<Result<_, _>>()?,
    };
    Ok(Sample { parts, source: String::new(), label: None })
}

/// Checks the names, types and shapes of the outputs that a session computes from zeros while it is warmed up. The
/// numbers in these outputs mean nothing and are not checked.
pub(super) fn check(card: &Card, outputs: &Outputs<'_, '_>) -> Result<(), OutputError> {
    let size = || card.picture().map(|picture| picture.size).ok_or(OutputError::NoPicture);
    match &card.task {
        Task::Classification(task) => class_numbers(&outputs.get(&task.name)?, task.labels.len()).map(drop),
        Task::Detection(task) => detection::check(task, outputs, size()?),
        Task::Segmentation(task) => segment::check(task, outputs),
        Task::Embedding(task) => outputs.get(&task.name)?.unbatched::<1>("[1, n]").map(drop),
        Task::Tensors(tensors) => {
            tensors.iter().try_for_each(|tensor| declared_output(tensor, outputs).map(drop))
        }
    }
}

/// Returns the numbers of a classifier, one for each class. They may be NaN.
fn class_numbers<'a>(output: &Output<'a>, labels: usize) -> Result<std::borrow::Cow<'a, [f32]>, OutputError> {
    let expected = format!("[1, {labels}] (`labels` of the card has {labels})");
    if output.unbatched(&expected)? != [labels] {
        return Err(output.wrong_shape(&expected));
    }
    output.unchecked_numbers()
}

/// Returns an output; checks that it has the shape that the card declares.
fn declared_output<'a>(
    tensor: &'a TensorOutput,
    outputs: &Outputs<'a, '_>,
) -> Result<Output<'a>, OutputError> {
    let output = outputs.get(&tensor.name)?;
    if output.shape != tensor.shape {
        return Err(output.wrong_shape(&format!("{:?}", tensor.shape)));
    }
    Ok(output)
}

fn embedding(task: &Embedding, output: &Output<'_>) -> Result<Part, OutputError> {
    let [length] = output.unbatched("[1, n]")?;
    let numbers = output.numbers()?;
    // The squares are 64-bit floats, so that none overflows.
    let norm = numbers.iter().map(|number| f64::from(*number).powi(2)).sum::<f64>().sqrt();
    let first_infinite = numbers.iter().find(|number| number.is_infinite());
    let name = || output.name.to_owned();
    let divisor = match (task.normalise, first_infinite) {
        (false, _) => 1.0,
        (true, Some(number)) => return Err(OutputError::NotFinite { name: name(), number: *number }),
        (true, None) if norm > 0.0 => norm,
        (true, None) => return Err(OutputError::NoDirection(name())),
    };
    let bytes = numbers.iter().flat_map(|number| ((f64::from(*number) / divisor) as f32).to_le_bytes());
    let description = DataType::Float32.array(&[length]);
    Ok(Part { description, bytes: bytes.collect::<Vec<u8>>().into() })
}

/// Returns an output as a part: an array with its type and shape.
fn tensor_part(output: &Output<'_>) -> Result<Part, OutputError> {
    let description = output.data_type.array(&output.shape);
    Ok(Part { description, bytes: output.bytes()?.into() })
}

fn json_part(text: Vec<u8>) -> Part {
    Part { description: Description::unshaped(MediaType::Json), bytes: Bytes::from(text) }
}
