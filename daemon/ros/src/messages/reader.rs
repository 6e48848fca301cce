//! Decoding of messages.

use bytes::Bytes;
use thiserror::Error;

use super::WireForm;

/// Largest padding after a message in CDR, where payloads are multiples of four bytes.
const MAX_CDR_PADDING: usize = 3;

/// Error: the bytes are not a message of the type.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DecodeError {
    /// The bytes end inside the message.
    #[error(
        "the message ends too early: {needed} bytes are needed at byte {offset}, but only {available} remain"
    )]
    TooShort {
        /// Position in the message.
        offset: usize,
        /// Number of bytes that the field needs.
        needed: usize,
        /// Number of remaining bytes.
        available: usize,
    },
    /// Bytes remain after the message.
    #[error("{count} bytes follow the end of the message; it may have another type")]
    TrailingBytes {
        /// Number of bytes after the message.
        count: usize,
    },
    /// A text is not UTF-8.
    #[error("the text at byte {offset} is not UTF-8")]
    NotUtf8 {
        /// Position in the message.
        offset: usize,
    },
    /// A text of CDR does not end with NUL.
    #[error("the text at byte {offset} has no NUL at its end")]
    UnterminatedText {
        /// Position in the message.
        offset: usize,
    },
    /// A boolean is neither 0 nor 1.
    #[error("byte {offset} is {value}, but a boolean is 0 or 1")]
    NotBoolean {
        /// Position in the message.
        offset: usize,
        /// Value of the byte.
        value: u8,
    },
    /// The encapsulation is not plain CDR.
    #[error(
        "encapsulation {first:#04x} {second:#04x} is not supported; publish with plain CDR of version 1 (00 00 or 00 01)"
    )]
    Encapsulation {
        /// First byte.
        first: u8,
        /// Second byte.
        second: u8,
    },
}

/// Reads the fields of one message.
///
/// No memory is allocated for a claimed length: every length is compared with the number of remaining bytes.
#[derive(Debug)]
pub struct Reader {
    form: WireForm,
    is_big_endian: bool,
    bytes: Bytes,
    offset: usize,
    /// Position from which alignment is counted.
    origin: usize,
}

impl Reader {
    /// Creates a reader. For CDR it reads the encapsulation header.
    ///
    /// # Errors
    /// If the header is missing or of another encapsulation.
    pub fn new(form: WireForm, bytes: Bytes) -> Result<Self, DecodeError> {
        let mut reader = Self { form, is_big_endian: false, bytes, offset: 0, origin: 0 };
        if form == WireForm::Cdr {
            // The other two bytes are options, which are ignored.
            let [first, second, ..] = reader.take_octets::<4>()?;
            if first != 0 || second > 1 {
                return Err(DecodeError::Encapsulation { first, second });
            }
            reader.is_big_endian = second == 0;
            reader.origin = reader.offset;
        }
        Ok(reader)
    }

    /// Returns the wire form.
    pub fn form(&self) -> WireForm {
        self.form
    }

    /// Returns the number of bytes not yet read.
    pub fn remaining(&self) -> usize {
        self.bytes.len() - self.offset
    }

    /// Returns the position of the next byte in the message.
    pub fn offset(&self) -> usize {
        self.offset
    }

    /// Skips `count` bytes. Returns the position of the first skipped byte.
    fn advance(&mut self, count: usize) -> Result<usize, DecodeError> {
        let (offset, available) = (self.offset, self.remaining());
        if count > available {
            return Err(DecodeError::TooShort { offset, needed: count, available });
        }
        self.offset += count;
        Ok(offset)
    }

    /// Reads bytes without alignment.
    ///
    /// # Errors
    /// If too few bytes remain.
    pub fn take_octets<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        let start = self.advance(N)?;
        let mut array = [0; N];
        array.copy_from_slice(&self.bytes[start..start + N]);
        Ok(array)
    }

    /// Reads a numeric value that is `N` bytes long. Returns its bytes in little-endian order.
    ///
    /// # Errors
    /// If too few bytes remain.
    pub fn take_number<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        if self.form == WireForm::Cdr {
            // A number is aligned to its own size, which is a power of two. The padding before the number is skipped.
            let position = self.offset - self.origin;
            self.advance(position.wrapping_neg() & (N - 1))?;
        }
        let mut number = self.take_octets()?;
        if self.is_big_endian {
            number.reverse();
        }
        Ok(number)
    }

    /// Reads the number of elements of a sequence whose elements have at least `min_element_bytes` bytes.
    ///
    /// # Errors
    /// If the remaining bytes cannot hold this number of elements.
    pub fn take_length(&mut self, min_element_bytes: usize) -> Result<usize, DecodeError> {
        let claimed = u32::from_le_bytes(self.take_number()?);
        // The conversion saturates, so that an impossible claim remains impossible.
        let length = usize::try_from(claimed).unwrap_or(usize::MAX);
        let needed = length.saturating_mul(min_element_bytes);
        let (offset, available) = (self.offset, self.remaining());
        if needed > available {
            return Err(DecodeError::TooShort { offset, needed, available });
        }
        Ok(length)
    }

    /// Reads a sequence of bytes. The result refers to the message's bytes.
    ///
    /// # Errors
    /// If too few bytes remain.
    pub fn take_bytes(&mut self) -> Result<Bytes, DecodeError> {
        let length = self.take_length(1)?;
        let start = self.advance(length)?;
        Ok(self.bytes.slice(start..start + length))
    }

    /// Reads a text.
    ///
    /// # Errors
    /// If the text is incomplete, not UTF-8, or has no NUL in CDR.
    pub fn take_text(&mut self) -> Result<String, DecodeError> {
        let offset = self.offset;
        let mut bytes = self.take_bytes()?;
        // Some writers of CDR give an empty text the length 0 instead of a single NUL.
        if self.form == WireForm::Cdr && !bytes.is_empty() && bytes.split_off(bytes.len() - 1)[0] != 0 {
            return Err(DecodeError::UnterminatedText { offset });
        }
        match std::str::from_utf8(&bytes) {
            Ok(text) => Ok(text.to_owned()),
            Err(_) => Err(DecodeError::NotUtf8 { offset }),
        }
    }

    /// Checks that the whole message has been read.
    ///
    /// # Errors
    /// If bytes remain that are not padding.
    pub fn finish(self) -> Result<(), DecodeError> {
        let max_padding = if self.form == WireForm::Cdr { MAX_CDR_PADDING } else { 0 };
        match self.remaining() {
            count if count <= max_padding => Ok(()),
            count => Err(DecodeError::TrailingBytes { count }),
        }
    }
}
