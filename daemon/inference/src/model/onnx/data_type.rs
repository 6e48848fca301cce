//! Types of the elements of inputs and outputs.

use std::fmt;
use std::ops::RangeInclusive;

use ort::value::TensorElementType;
use peernet_sample::{Description, ElementType, MediaType};
use serde::Deserialize;

/// Type of the elements of an input or output, by its name in cards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum DataType {
    Float16,
    Float32,
    Float64,
    Int8,
    Int16,
    Int32,
    Int64,
    Uint8,
    Uint16,
    Uint32,
    Uint64,
    Bool,
}

/// Each type with its name in cards, its name in samples, and its name in ONNX Runtime.
const NAMES: [(DataType, &str, ElementType, TensorElementType); 12] = [
    (DataType::Float16, "float16", ElementType::F16, TensorElementType::Float16),
    (DataType::Float32, "float32", ElementType::F32, TensorElementType::Float32),
    (DataType::Float64, "float64", ElementType::F64, TensorElementType::Float64),
    (DataType::Int8, "int8", ElementType::I8, TensorElementType::Int8),
    (DataType::Int16, "int16", ElementType::I16, TensorElementType::Int16),
    (DataType::Int32, "int32", ElementType::I32, TensorElementType::Int32),
    (DataType::Int64, "int64", ElementType::I64, TensorElementType::Int64),
    (DataType::Uint8, "uint8", ElementType::U8, TensorElementType::Uint8),
    (DataType::Uint16, "uint16", ElementType::U16, TensorElementType::Uint16),
    (DataType::Uint32, "uint32", ElementType::U32, TensorElementType::Uint32),
    (DataType::Uint64, "uint64", ElementType::U64, TensorElementType::Uint64),
    (DataType::Bool, "bool", ElementType::Bool, TensorElementType::Bool),
];

impl DataType {
    /// Returns the type that ONNX Runtime names; `None` if no card can name it.
    pub(super) fn from_onnx(onnx: TensorElementType) -> Option<Self> {
        NAMES.iter().find(|names| names.3 == onnx).map(|names| names.0)
    }

    /// Returns the type that descriptions of samples name; `None` if no card can name it.
    pub(super) fn from_element(element: ElementType) -> Option<Self> {
        NAMES.iter().find(|names| names.2 == element).map(|names| names.0)
    }

    /// Returns the type's name in descriptions of samples.
    pub(super) fn element(self) -> ElementType {
        self.names().2
    }

    /// Returns the description of an array of this type and shape.
    pub(super) fn array(self, shape: &[usize]) -> Description {
        let shape = shape.iter().map(|length| u32::try_from(*length).unwrap_or(u32::MAX)).collect();
        Description { media: MediaType::Tensor, shape, element: Some(self.element()) }
    }

    pub(super) const fn is_float(self) -> bool {
        matches!(self, Self::Float16 | Self::Float32 | Self::Float64)
    }

    /// Returns the integers of the type, 0 and 1 for truth values; `None` for a floating-point type.
    pub(super) fn integers(self) -> Option<RangeInclusive<i128>> {
        match self {
            Self::Float16 | Self::Float32 | Self::Float64 => None,
            Self::Int8 => Some(i8::MIN.into()..=i8::MAX.into()),
            Self::Int16 => Some(i16::MIN.into()..=i16::MAX.into()),
            Self::Int32 => Some(i32::MIN.into()..=i32::MAX.into()),
            Self::Int64 => Some(i64::MIN.into()..=i64::MAX.into()),
            Self::Uint8 => Some(0..=u8::MAX.into()),
            Self::Uint16 => Some(0..=u16::MAX.into()),
            Self::Uint32 => Some(0..=u32::MAX.into()),
            Self::Uint64 => Some(0..=u64::MAX.into()),
            Self::Bool => Some(0..=1),
        }
    }

    fn names(self) -> &'static (Self, &'static str, ElementType, TensorElementType) {
        // The variants are declared in the order of `NAMES`; a test checks this.
        &NAMES[self as usize]
    }
}

impl fmt::Display for DataType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.names().1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_type_has_its_own_names() {
        for (index, (data_type, name, element, onnx)) in NAMES.into_iter().enumerate() {
            assert_eq!((data_type as usize, data_type.to_string().as_str()), (index, name));
            assert_eq!((DataType::from_onnx(onnx), data_type.element()), (Some(data_type), element));
            assert_eq!(DataType::from_element(element), Some(data_type));
            let read: DataType = serde_json::from_value(name.into()).expect("is a name of a card");
            assert_eq!(read, data_type);
        }
        assert_eq!(DataType::from_onnx(TensorElementType::String), None);
    }
}
