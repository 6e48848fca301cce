//! The outputs of a run of the session, with checks of their names, types and shapes.

use std::borrow::Cow;

use half::f16;
use ort::session::SessionOutputs;
use ort::value::{DynValue, TensorElementType, ValueType};

use super::data_type::DataType;
use super::numbers::Element;

/// Reason why outputs cannot be converted to an answer.
#[derive(Debug, thiserror::Error)]
pub(super) enum OutputError {
    /// Error of ONNX Runtime.
    #[error(transparent)]
    Runtime(#[from] ort::Error),
    /// The model has no such output.
    #[error("there is no output {0:?}")]
    Missing(String),
    /// The output has another type than the card requires.
    #[error("its output {name:?} has elements of type {actual}, {expected} are required")]
    Type { name: String, actual: String, expected: &'static str },
    /// The output has another shape than the card requires.
    #[error("its output {name:?} has the shape {actual:?}, {expected} is required")]
    Shape { name: String, actual: Vec<usize>, expected: String },
    /// The output contains a number that is not finite.
    #[error("its output {name:?} contains {number}")]
    NotFinite { name: String, number: f32 },
    /// The output contains NaN.
    #[error("its output {0:?} contains NaN")]
    NotANumber(String),
    /// The output with the number of valid rows states an impossible number.
    #[error(
        "its output {name:?} states {count} valid rows of {rows}; it must be a whole number from 0 to {rows}"
    )]
    RowCount { name: String, count: f32, rows: usize },
    /// The output names a class that the card does not have.
    #[error("its output {name:?} names class {class}, its card has labels for 0 to {}", .labels - 1)]
    UnknownClass { name: String, class: f32, labels: usize },
    /// The card has no labels.
    #[error("it has no classes")]
    NoClasses,
    /// A vector of zeros has no direction.
    #[error("its output {0:?} consists of zeros, so it cannot be normalised")]
    NoDirection(String),
    /// The answer relates to a picture, but the sample had none.
    #[error("its sample has no picture")]
    NoPicture,
    /// The answer cannot be encoded.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
}

/// The outputs for one sample of a run, in the host's memory.
pub(super) struct Outputs<'a, 'run> {
    run: &'a SessionOutputs<'run>,
    row: Row,
}

/// Position of a sample in the batch of a run.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    /// Position of the sample, from 0.
    pub(super) index: usize,
    /// Number of samples in the batch.
    pub(super) batch: usize,
}

/// An output for one sample.
pub(super) struct Output<'a> {
    pub(super) name: &'a str,
    pub(super) shape: Vec<usize>,
    pub(super) data_type: DataType,
    value: &'a DynValue,
    row: Row,
}

impl<'a, 'run> Outputs<'a, 'run> {
    /// Returns the outputs of the sample at `row`.
    pub(super) const fn new(run: &'a SessionOutputs<'run>, row: Row) -> Self {
        Self { run, row }
    }

    /// Returns an output by its name.
    ///
    /// # Errors
    /// If the model has no such output, if it is not an array of a type that cards can name, or if it does not have a
    /// row for each sample of the batch.
    pub(super) fn get(&self, name: &'a str) -> Result<Output<'a>, OutputError> {
        let value = self.run.get(name).ok_or_else(|| OutputError::Missing(name.to_owned()))?;
        let unusable = |actual: String| OutputError::Type {
            name: name.to_owned(),
            actual,
            expected: "numbers or truth values",
        };
        let ValueType::Tensor { ty, shape, .. } = value.dtype() else {
            return Err(unusable(value.dtype().to_string()));
        };
        let data_type = DataType::from_onnx(*ty).ok_or_else(|| unusable(ty.to_string()))?;
        let shape = shape.iter().map(|length| usize::try_from(*length).unwrap_or_default()).collect();
        let mut output = Output { name, shape, data_type, value, row: self.row };
        let batch = self.row.batch;
        match output.shape.first_mut() {
            // The output for a single sample need not have a dimension for the batch.
            _ if batch == 1 => {}
            // The shape becomes that of the output for one sample.
            Some(rows) if *rows == batch => *rows = 1,
            _ => {
                return Err(output.wrong_shape(&format!("[{batch}, …], a row for each sample of the batch,")));
            }
        }
        Ok(output)
    }
}

impl<'a> Output<'a> {
    /// Returns the last `RANK` lengths of the shape. The other lengths belong to the batch and must be 1.
    ///
    /// # Errors
    /// If a length of the batch is not 1, or the shape has fewer than `RANK` lengths. The message says that
    /// `expected` is required.
    pub(super) fn unbatched<const RANK: usize>(&self, expected: &str) -> Result<[usize; RANK], OutputError> {
        let surplus = self.shape.len().saturating_sub(RANK);
        let (batch, shape) = self.shape.split_at(surplus);
        match shape.try_into() {
            Ok(shape) if batch.iter().all(|length| *length == 1) => Ok(shape),
            _ => Err(self.wrong_shape(expected)),
        }
    }

    /// Returns the error that says which shape is required.
    pub(super) fn wrong_shape(&self, expected: &str) -> OutputError {
        OutputError::Shape {
            name: self.name.to_owned(),
            actual: self.shape.clone(),
            expected: expected.to_owned(),
        }
    }

    /// Returns the numbers as 32-bit floats. Numbers that already are 32-bit floats are not copied.
    ///
    /// # Errors
    /// If one of them is NaN.
    pub(super) fn numbers(&self) -> Result<Cow<'a, [f32]>, OutputError> {
        let numbers = self.unchecked_numbers()?;
        // `fold` has no branch for each number, so that the compiler vectorises the loop.
        if numbers.iter().fold(false, |any, number| any | number.is_nan()) {
            return Err(OutputError::NotANumber(self.name.to_owned()));
        }
        Ok(numbers)
    }

    /// Returns the numbers as 32-bit floats, which may be NaN. Numbers that already are 32-bit floats are not copied.
    pub(super) fn unchecked_numbers(&self) -> Result<Cow<'a, [f32]>, OutputError> {
        Ok(match self.data_type {
            DataType::Float32 => Cow::Borrowed(self.elements::<f32>()?),
            DataType::Float16 => self.convert::<f16>()?,
            DataType::Float64 => self.convert::<f64>()?,
            DataType::Int8 => self.convert::<i8>()?,
            DataType::Int16 => self.convert::<i16>()?,
            DataType::Int32 => self.convert::<i32>()?,
            DataType::Int64 => self.convert::<i64>()?,
            DataType::Uint8 => self.convert::<u8>()?,
            DataType::Uint16 => self.convert::<u16>()?,
            DataType::Uint32 => self.convert::<u32>()?,
            DataType::Uint64 => self.convert::<u64>()?,
            DataType::Bool => self.convert::<bool>()?,
        })
    }

    /// Returns the elements of the sample's row.
    fn elements<T: ort::value::PrimitiveTensorElementType>(&self) -> ort::Result<&'a [T]> {
        let (_, elements) = self.value.try_extract_tensor::<T>()?;
        let count = elements.len() / self.row.batch;
        Ok(&elements[self.row.index * count..][..count])
    }

    fn convert<T: Element + ort::value::PrimitiveTensorElementType>(
        &self,
    ) -> Result<Cow<'a, [f32]>, OutputError> {
        let elements = self.elements::<T>()?;
        Ok(Cow::Owned(elements.iter().map(|element| element.to_f32()).collect()))
    }

    /// Returns the numbers as the bytes of a sample: little-endian, a truth value as 0 or 1.
    ///
    /// # Errors
    /// If one of them is NaN.
    pub(super) fn bytes(&self) -> Result<Vec<u8>, OutputError> {
        match self.data_type {
            DataType::Float16 => self.to_bytes(f16::to_le_bytes),
            DataType::Float32 => self.to_bytes(f32::to_le_bytes),
            DataType::Float64 => self.to_bytes(f64::to_le_bytes),
            DataType::Int8 => self.to_bytes(i8::to_le_bytes),
            DataType::Int16 => self.to_bytes(i16::to_le_bytes),
            DataType::Int32 => self.to_bytes(i32::to_le_bytes),
            DataType::Int64 => self.to_bytes(i64::to_le_bytes),
            DataType::Uint8 => self.to_bytes(u8::to_le_bytes),
            DataType::Uint16 => self.to_bytes(u16::to_le_bytes),
            DataType::Uint32 => self.to_bytes(u32::to_le_bytes),
            DataType::Uint64 => self.to_bytes(u64::to_le_bytes),
            DataType::Bool => self.to_bytes(|truth: bool| [u8::from(truth)]),
        }
    }

    fn to_bytes<T, const BYTES: usize>(
        &self,
        encode: impl Fn(T) -> [u8; BYTES],
    ) -> Result<Vec<u8>, OutputError>
    where
        T: Element + ort::value::PrimitiveTensorElementType,
    {
        let elements = self.elements::<T>()?;
        if elements.iter().fold(false, |any, element| any | element.is_nan()) {
            return Err(OutputError::NotANumber(self.name.to_owned()));
        }
        let mut bytes = vec![0; elements.len() * BYTES];
        let (chunks, _) = bytes.as_chunks_mut::<BYTES>();
        for (chunk, element) in chunks.iter_mut().zip(elements) {
            *chunk = encode(*element);
        }
        Ok(bytes)
    }
}

/// Returns whether an element type of ONNX Runtime is a float that cards can name.
pub(super) fn is_float(onnx: TensorElementType) -> bool {
    DataType::from_onnx(onnx).is_some_and(DataType::is_float)
}
