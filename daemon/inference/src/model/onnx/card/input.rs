//! The table `[input]` of a card, or its tables `[[input]]`: the type, the shape and the source of each input of the
//! model.

use std::collections::HashSet;

use half::f16;
use serde::de::Error;
use serde::{Deserialize, Deserializer};

use super::ModelCardError;
use super::preprocessing::{Colour, Layout, Normalisation, Preprocessing};
use crate::model::onnx::data_type::DataType;

/// An input of the model.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::model::onnx) struct Input {
    /// Name of the model's input.
    pub(in crate::model::onnx) name: String,
    pub(in crate::model::onnx) data_type: DataType,
    /// Lengths of the dimensions, each larger than 0.
    pub(in crate::model::onnx) shape: Vec<usize>,
    pub(in crate::model::onnx) source: Source,
}

/// Origin of an input's numbers.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::model::onnx) enum Source {
    /// A picture in the sample's next part.
    Picture(Box<PictureSource>),
    /// An array in the sample's next part, of the input's type and shape.
    Array,
    /// Numbers in the card: one number for all elements, or one number for each element.
    Constant(Vec<f64>),
}

/// Conversion of a picture to an input.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::model::onnx) struct PictureSource {
    pub(in crate::model::onnx) layout: Layout,
    pub(in crate::model::onnx) colour: Colour,
    pub(in crate::model::onnx) preprocessing: Preprocessing,
    pub(in crate::model::onnx) normalisation: Normalisation,
    /// Width and height of the input, pixels.
    pub(in crate::model::onnx) size: (u32, u32),
}

/// The table of an input as written in the card.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct InputTable {
    name: String,
    dtype: DataType,
    #[serde(deserialize_with = "lengths")]
    shape: Vec<usize>,
    /// Order of a picture's dimensions, which are the last three of `shape`.
    layout: Option<Layout>,
    colour: Option<Colour>,
    /// Preprocessing of the pictures for this input. Default: the card's table `[preprocessing]`.
    preprocessing: Option<Preprocessing>,
    /// Value of a constant: a number, or a list of numbers or further lists.
    #[serde(default, deserialize_with = "numbers")]
    value: Option<Vec<f64>>,
}

impl Input {
    /// Converts and checks the tables of a card; `shared` is the card's table `[preprocessing]`, for inputs without
    /// preprocessing of their own.
    pub(super) fn from_tables(
        tables: Vec<InputTable>,
        shared: Option<&Preprocessing>,
    ) -> Result<Vec<Self>, ModelCardError> {
        if tables.is_empty() {
            return Err(ModelCardError::NoInput);
        }
        let inputs = tables.into_iter().map(|table| Self::from_table(table, shared));
        let inputs = inputs.collect::<Result<Vec<_>, _>>()?;
        let mut names = HashSet::new();
        if let Some(input) = inputs.iter().find(|input| !names.insert(&input.name)) {
            return Err(ModelCardError::DuplicateName { table: "input", name: input.name.clone() });
        }
        if shared.is_some() && !inputs.iter().any(|input| input.picture().is_some()) {
            return Err(ModelCardError::NoPicture);
        }
        Ok(inputs)
    }

    fn from_table(table: InputTable, shared: Option<&Preprocessing>) -> Result<Self, ModelCardError> {
        let InputTable { name, dtype: data_type, shape, layout, colour, preprocessing, value } = table;
        let is_picture = layout.is_some() || colour.is_some() || preprocessing.is_some();
        let source = match value {
            Some(_) if is_picture => return Err(ModelCardError::ConstantPicture(name)),
            Some(value) => Source::Constant(check_constant(&name, data_type, &shape, value)?),
            None if is_picture => {
                let missing = |key| ModelCardError::IncompletePicture { input: name.clone(), missing: key };
                let layout = layout.ok_or_else(|| missing("layout"))?;
                let colour = colour.ok_or_else(|| missing("colour"))?;
                let preprocessing =
                    preprocessing.or(shared.cloned()).ok_or_else(|| missing("preprocessing"))?;
                let source = PictureSource::new(&name, data_type, &shape, (layout, colour), preprocessing)?;
                Source::Picture(Box::new(source))
            }
            None => Source::Array,
        };
        Ok(Self { name, data_type, shape, source })
    }

    /// Returns the conversion of a picture, if the input is a picture.
    pub(in crate::model::onnx) fn picture(&self) -> Option<&PictureSource> {
        match &self.source {
            Source::Picture(picture) => Some(picture),
            Source::Array | Source::Constant(_) => None,
        }
    }

    /// Returns the number of elements.
    pub(in crate::model::onnx) fn element_count(&self) -> usize {
        self.shape.iter().product()
    }
}

impl PictureSource {
    fn new(
        name: &str,
        data_type: DataType,
        shape: &[usize],
        (layout, colour): (Layout, Colour),
        preprocessing: Preprocessing,
    ) -> Result<Self, ModelCardError> {
        if data_type == DataType::Bool {
            return Err(ModelCardError::PictureType(name.to_owned()));
        }
        let rank = shape.len();
        let (channels, height, width) =
            layout.dimensions(shape).ok_or_else(|| ModelCardError::Rank { input: name.to_owned(), rank })?;
        if let Some(batch) = shape[..rank - 3].iter().find(|length| **length != 1) {
            return Err(ModelCardError::Batch(*batch));
        }
        let expected = colour.channels();
        if channels != expected {
            let with_other_layout = layout.other().dimensions(shape);
            let fits_other_layout = with_other_layout.is_some_and(|(channels, ..)| channels == expected);
            return Err(ModelCardError::Channels { channels, layout, colour, expected, fits_other_layout });
        }
        let has_defaults = !data_type.is_float();
        let normalisation = preprocessing.normalisation(channels, has_defaults)?;
        preprocessing.check_size((width, height))?;
        let size = (width as u32, height as u32);
        Ok(Self { layout, colour, preprocessing, normalisation, size })
    }
}

/// Checks the number of a constant's values, and that the input's type can represent each value.
fn check_constant(
    input: &str,
    data_type: DataType,
    shape: &[usize],
    values: Vec<f64>,
) -> Result<Vec<f64>, ModelCardError> {
    let (input, expected) = (input.to_owned(), shape.iter().product::<usize>());
    if values.len() != 1 && values.len() != expected {
        return Err(ModelCardError::ConstantLength { input, count: values.len(), expected });
    }
    let is_representable = |value: f64| match data_type.integers() {
        // Integers must not be rounded. All integer types are within the range of 128-bit integers.
        Some(integers) => value.fract() == 0.0 && integers.contains(&(value as i128)),
        // Floats may be rounded, but not to infinity.
        None => match data_type {
            DataType::Float16 => f16::from_f64(value).is_finite(),
            DataType::Float32 => (value as f32).is_finite(),
            _ => true,
        },
    };
    match values.iter().find(|value| !value.is_finite() || !is_representable(**value)) {
        Some(value) => Err(ModelCardError::ConstantValue { input, value: *value, data_type }),
        None => Ok(values),
    }
}

/// Deserialises the lengths of a shape. An exported model often has -1 or a name for a dimension without a fixed
/// length; a card must state a number.
pub(super) fn lengths<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<usize>, D::Error> {
    let length = |value: &toml::Value| {
        let length = value.as_integer().and_then(|number| usize::try_from(number).ok());
        length.filter(|length| *length > 0).ok_or_else(|| {
            D::Error::custom(format_args!(
                "a length is {value}; write the length with which the model is run, and 1 for the batch"
            ))
        })
    };
    let shape = Vec::<toml::Value>::deserialize(deserializer)?;
    let shape = shape.iter().map(length).collect::<Result<Vec<usize>, _>>()?;
    let count = shape.iter().try_fold(1_usize, |count, length| count.checked_mul(*length));
    match count.filter(|count| *count <= MAX_ELEMENTS) {
        Some(_) => Ok(shape),
        None => Err(D::Error::custom(format_args!("a shape has at most {MAX_ELEMENTS} elements"))),
    }
}

/// Maximum number of elements of an input or output: a gigabyte of 32-bit floats.
const MAX_ELEMENTS: usize = 1 << 28;

/// Deserialises a number or a nested list of numbers, as a flat list.
fn numbers<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Vec<f64>>, D::Error> {
    fn flatten<E: Error>(value: &toml::Value, numbers: &mut Vec<f64>) -> Result<(), E> {
        match value {
            // A 64-bit float cannot represent every larger integer.
            toml::Value::Integer(number) if number.unsigned_abs() > 1 << f64::MANTISSA_DIGITS => {
                return Err(E::custom(format_args!(
                    "{number} is not between -2^53 and 2^53; write it as a constant of the model's graph"
                )));
            }
            toml::Value::Integer(number) => numbers.push(*number as f64),
            toml::Value::Float(number) => numbers.push(*number),
            toml::Value::Boolean(truth) => numbers.push(f64::from(u8::from(*truth))),
            toml::Value::Array(values) => values.iter().try_for_each(|value| flatten(value, numbers))?,
            other => return Err(E::custom(format_args!("{other} is not a number"))),
        }
        Ok(())
    }
    let mut flat = Vec::new();
    flatten(&toml::Value::deserialize(deserializer)?, &mut flat)?;
    Ok(Some(flat))
}
