//! Values that are fields of messages.

use bytes::Bytes;

use super::{DecodeError, EncodeError, Reader, Writer};

/// A value that can be a field of a message: a number, text, sequence or structure.
pub trait Field: Sized {
    /// Minimum number of bytes of a value in any wire form; never 0.
    // With 0, the remaining bytes would not limit the claimed length of a sequence.
    const MIN_BYTES: usize;

    /// Writes the value.
    ///
    /// # Errors
    /// If the wire form cannot represent it.
    fn write(&self, writer: &mut Writer) -> Result<(), EncodeError>;

    /// Reads a value.
    ///
    /// # Errors
    /// If the bytes are not a value of this type.
    fn read(reader: &mut Reader) -> Result<Self, DecodeError>;
}

macro_rules! number_fields {
    ($($number:ty),*) => {$(
        impl Field for $number {
            const MIN_BYTES: usize = size_of::<$number>();

            fn write(&self, writer: &mut Writer) -> Result<(), EncodeError> {
                writer.put_number(self.to_le_bytes());
                Ok(())
            }

            fn read(reader: &mut Reader) -> Result<Self, DecodeError> {
                Ok(<$number>::from_le_bytes(reader.take_number()?))
            }
        }
    )*};
}

number_fields!(u8, u32, u64, i32, f64);

impl Field for bool {
    const MIN_BYTES: usize = 1;

    fn write(&self, writer: &mut Writer) -> Result<(), EncodeError> {
        u8::from(*self).write(writer)
    }

    fn read(reader: &mut Reader) -> Result<Self, DecodeError> {
        let offset = reader.offset();
        match u8::read(reader)? {
            0 => Ok(false),
            1 => Ok(true),
            value => Err(DecodeError::NotBoolean { offset, value }),
        }
    }
}

impl Field for String {
    const MIN_BYTES: usize = 4;

    fn write(&self, writer: &mut Writer) -> Result<(), EncodeError> {
        writer.put_text(self)
    }

    fn read(reader: &mut Reader) -> Result<Self, DecodeError> {
        reader.take_text()
    }
}

impl Field for Bytes {
    const MIN_BYTES: usize = 4;

    fn write(&self, writer: &mut Writer) -> Result<(), EncodeError> {
        writer.put_bytes(self)
    }

    fn read(reader: &mut Reader) -> Result<Self, DecodeError> {
        reader.take_bytes()
    }
}

impl<T: Field> Field for Vec<T> {
    const MIN_BYTES: usize = 4;

    fn write(&self, writer: &mut Writer) -> Result<(), EncodeError> {
        writer.put_length(self.len())?;
        self.iter().try_for_each(|element| element.write(writer))
    }

    fn read(reader: &mut Reader) -> Result<Self, DecodeError> {
        let length = reader.take_length(T::MIN_BYTES)?;
        (0..length).map(|_| T::read(reader)).collect()
    }
}

impl<T: Field + Copy + Default, const N: usize> Field for [T; N] {
    const MIN_BYTES: usize = N * T::MIN_BYTES;

    fn write(&self, writer: &mut Writer) -> Result<(), EncodeError> {
        self.iter().try_for_each(|element| element.write(writer))
    }

    fn read(reader: &mut Reader) -> Result<Self, DecodeError> {
        let mut array = [T::default(); N];
        for element in &mut array {
            *element = T::read(reader)?;
        }
        Ok(array)
    }
}

/// Implements [`Field`] for a struct by its fields in the order of the wire form.
macro_rules! struct_field {
    ($name:ident { $($field:ident: $kind:ty),* $(,)? }) => {
        impl $crate::messages::Field for $name {
            const MIN_BYTES: usize = 0 $(+ <$kind as $crate::messages::Field>::MIN_BYTES)*;

            fn write(
                &self,
                writer: &mut $crate::messages::Writer,
            ) -> Result<(), $crate::messages::EncodeError> {
                $($crate::messages::Field::write(&self.$field, writer)?;)*
                Ok(())
            }

            fn read(
                reader: &mut $crate::messages::Reader,
            ) -> Result<Self, $crate::messages::DecodeError> {
                Ok(Self { $($field: $crate::messages::Field::read(reader)?),* })
            }
        }
    };
}

pub(super) use struct_field;
