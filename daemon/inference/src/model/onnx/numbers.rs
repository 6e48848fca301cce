//! Numbers of any element type, in inputs and outputs.

use std::ops::Range;

use half::f16;
use ort::session::SessionInputValue;
use ort::value::TensorRef;

use super::data_type::DataType;

/// Element of a tensor.
pub(super) trait Element: Copy {
    /// Converts a number. For integers, the number is rounded (half away from zero) and limited to the range of the
    /// type.
    fn from_f32(number: f32) -> Self;

    /// Converts a number, as [`from_f32`](Self::from_f32) does.
    fn from_f64(number: f64) -> Self;

    /// Returns the nearest 32-bit float.
    fn to_f32(self) -> f32;

    /// Returns whether the element is NaN. Integers and truth values are never NaN.
    fn is_nan(self) -> bool {
        false
    }
}

impl Element for f32 {
    fn from_f32(number: f32) -> Self {
        number
    }

    fn from_f64(number: f64) -> Self {
        number as Self
    }

    fn to_f32(self) -> f32 {
        self
    }

    fn is_nan(self) -> bool {
        // The type's own function, which Rust prefers to this function of the trait.
        Self::is_nan(self)
    }
}

impl Element for f64 {
    fn from_f32(number: f32) -> Self {
        number.into()
    }

    fn from_f64(number: f64) -> Self {
        number
    }

    fn to_f32(self) -> f32 {
        self as f32
    }

    fn is_nan(self) -> bool {
        // The type's own function, which Rust prefers to this function of the trait.
        Self::is_nan(self)
    }
}

// Each call below calls the function of the type `f16` itself, because Rust prefers a type's own function to a function
// of a trait that has the same name.
impl Element for f16 {
    fn from_f32(number: f32) -> Self {
        Self::from_f32(number)
    }

    fn from_f64(number: f64) -> Self {
        Self::from_f64(number)
    }

    fn to_f32(self) -> f32 {
        Self::to_f32(self)
    }

    fn is_nan(self) -> bool {
        Self::is_nan(self)
    }
}

impl Element for bool {
    fn from_f32(number: f32) -> Self {
        number != 0.0
    }

    fn from_f64(number: f64) -> Self {
        number != 0.0
    }

    fn to_f32(self) -> f32 {
        f32::from(u8::from(self))
    }
}

macro_rules! integers {
    ($($integer:ty: $to_f32:expr),*) => {$(
        impl Element for $integer {
            fn from_f32(number: f32) -> Self {
                // `as` limits a number to the range of the type.
                number.round() as Self
            }

            fn from_f64(number: f64) -> Self {
                number.round() as Self
            }

            fn to_f32(self) -> f32 {
                let to_f32: fn(Self) -> f32 = $to_f32;
                to_f32(self)
            }
        }
    )*};
}

// A 32-bit float cannot represent every integer of more than 24 bits: `as` takes the nearest float.
integers!(
    i8: f32::from,
    i16: f32::from,
    i32: |number| number as f32,
    i64: |number| number as f32,
    u8: f32::from,
    u16: f32::from,
    u32: |number| number as f32,
    u64: |number| number as f32
);

/// Evaluates an expression for the vector in `$numbers`, independent of the element type.
macro_rules! for_elements {
    ($numbers:expr, $elements:ident => $result:expr) => {
        match $numbers {
            Numbers::Float16($elements) => $result,
            Numbers::Float32($elements) => $result,
            Numbers::Float64($elements) => $result,
            Numbers::Int8($elements) => $result,
            Numbers::Int16($elements) => $result,
            Numbers::Int32($elements) => $result,
            Numbers::Int64($elements) => $result,
            Numbers::Uint8($elements) => $result,
            Numbers::Uint16($elements) => $result,
            Numbers::Uint32($elements) => $result,
            Numbers::Uint64($elements) => $result,
            Numbers::Bool($elements) => $result,
        }
    };
}

pub(super) use for_elements;

/// The numbers of a tensor, in row-major order.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Numbers {
    Float16(Vec<f16>),
    Float32(Vec<f32>),
    Float64(Vec<f64>),
    Int8(Vec<i8>),
    Int16(Vec<i16>),
    Int32(Vec<i32>),
    Int64(Vec<i64>),
    Uint8(Vec<u8>),
    Uint16(Vec<u16>),
    Uint32(Vec<u32>),
    Uint64(Vec<u64>),
    Bool(Vec<bool>),
}

impl Numbers {
    /// Creates `count` zeros.
    pub(super) fn zeros(data_type: DataType, count: usize) -> Self {
        match data_type {
            DataType::Float16 => Self::Float16(vec![f16::ZERO; count]),
            DataType::Float32 => Self::Float32(vec![0.0; count]),
            DataType::Float64 => Self::Float64(vec![0.0; count]),
            DataType::Int8 => Self::Int8(vec![0; count]),
            DataType::Int16 => Self::Int16(vec![0; count]),
            DataType::Int32 => Self::Int32(vec![0; count]),
            DataType::Int64 => Self::Int64(vec![0; count]),
            DataType::Uint8 => Self::Uint8(vec![0; count]),
            DataType::Uint16 => Self::Uint16(vec![0; count]),
            DataType::Uint32 => Self::Uint32(vec![0; count]),
            DataType::Uint64 => Self::Uint64(vec![0; count]),
            DataType::Bool => Self::Bool(vec![false; count]),
        }
    }

    /// Returns the number of elements.
    pub(super) fn len(&self) -> usize {
        for_elements!(self, elements => elements.len())
    }

    /// Replaces all numbers by `values`; repeats `values` if there are more numbers than values.
    pub(super) fn fill(&mut self, values: &[f64]) {
        for_elements!(self, elements => fill(elements, values));
    }

    /// Replaces the numbers in `range` by those that `bytes` contains, little-endian. The caller has checked the number
    /// of bytes. For truth values, a byte other than 0 is true.
    pub(super) fn read(&mut self, range: Range<usize>, bytes: &[u8]) {
        match self {
            Self::Float16(elements) => copy(&mut elements[range], bytes, f16::from_le_bytes),
            Self::Float32(elements) => copy(&mut elements[range], bytes, f32::from_le_bytes),
            Self::Float64(elements) => copy(&mut elements[range], bytes, f64::from_le_bytes),
            Self::Int8(elements) => copy(&mut elements[range], bytes, i8::from_le_bytes),
            Self::Int16(elements) => copy(&mut elements[range], bytes, i16::from_le_bytes),
            Self::Int32(elements) => copy(&mut elements[range], bytes, i32::from_le_bytes),
            Self::Int64(elements) => copy(&mut elements[range], bytes, i64::from_le_bytes),
            Self::Uint8(elements) => elements[range].copy_from_slice(bytes),
            Self::Uint16(elements) => copy(&mut elements[range], bytes, u16::from_le_bytes),
            Self::Uint32(elements) => copy(&mut elements[range], bytes, u32::from_le_bytes),
            Self::Uint64(elements) => copy(&mut elements[range], bytes, u64::from_le_bytes),
            Self::Bool(elements) => copy(&mut elements[range], bytes, |[byte]| byte != 0),
        }
    }

    /// Returns the first numbers, as many as `shape` has elements, as an input of a session. The numbers are not
    /// copied.
    pub(super) fn as_input<'a>(&'a self, shape: &'a [usize]) -> ort::Result<SessionInputValue<'a>> {
        for_elements!(self, elements => {
            TensorRef::from_array_view((shape, &elements[..shape.iter().product()])).map(SessionInputValue::from)
        })
    }
}

fn fill<T: Element>(elements: &mut [T], values: &[f64]) {
    for (element, value) in elements.iter_mut().zip(values.iter().cycle()) {
        *element = T::from_f64(*value);
    }
}

fn copy<T, const BYTES: usize>(elements: &mut [T], bytes: &[u8], from_bytes: impl Fn([u8; BYTES]) -> T) {
    // The caller has compared the number of bytes with the shape, so there is no remainder.
    let (chunks, _) = bytes.as_chunks();
    for (element, chunk) in elements.iter_mut().zip(chunks) {
        *element = from_bytes(*chunk);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_are_rounded_and_limited() {
        let mut bytes = Numbers::zeros(DataType::Uint8, 4);
        bytes.fill(&[-3.0, 254.5, 300.0, 7.4]);
        assert_eq!(bytes, Numbers::Uint8(vec![0, 255, 255, 7]));
        let mut signed = Numbers::zeros(DataType::Int8, 2);
        signed.fill(&[-128.6]);
        assert_eq!(signed, Numbers::Int8(vec![-128, -128]));
    }

    #[test]
    fn bytes_of_sample_are_little_endian() {
        let mut numbers = Numbers::zeros(DataType::Int16, 2);
        numbers.read(0..2, &[1, 0, 0xfe, 0xff]);
        assert_eq!(numbers, Numbers::Int16(vec![1, -2]));
        let mut halves = Numbers::zeros(DataType::Float16, 1);
        halves.read(0..1, &[0x00, 0x3c]);
        assert_eq!(halves, Numbers::Float16(vec![f16::ONE]));
        let mut truths = Numbers::zeros(DataType::Bool, 3);
        truths.read(0..3, &[0, 1, 2]);
        assert_eq!(truths, Numbers::Bool(vec![false, true, true]));
    }
}
