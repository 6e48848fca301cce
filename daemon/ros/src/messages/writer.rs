//! Encoding of messages.

use std::sync::Arc;

use bytes::{BufMut, Bytes, BytesMut};
use thiserror::Error;

use super::WireForm;

/// Length from which on a sequence of bytes becomes a separate segment and is not copied, bytes. Copying a shorter
/// sequence is cheaper than one more entry of a vectored write.
const MIN_SEGMENT_BYTES: usize = 4096;

/// Encapsulation header of little-endian plain CDR, version 1, without options.
const CDR_LITTLE_ENDIAN: [u8; 4] = [0, 1, 0, 0];

/// Error: a wire form cannot represent a value.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum EncodeError {
    /// A sequence or text has more elements than a 32-bit length allows.
    #[error("a sequence of {length} elements is too long for a ROS message, whose lengths have 32 bits")]
    TooLong {
        /// Number of elements, or of bytes of a text.
        length: usize,
    },
    /// A text contains a NUL, which ends a text in CDR.
    #[error("the text {text:?} contains a NUL character, which ends a text in ROS 2; remove it")]
    NulInText {
        /// The text.
        text: String,
    },
    /// The seconds are outside the range of the wire form's time.
    #[error(
        "the time {seconds} s cannot be sent: ROS 1 allows 0 to 2^32 − 1, ROS 2 allows −2^31 to 2^31 − 1"
    )]
    TimeOutOfRange {
        /// Seconds since the epoch of the publisher's clock.
        seconds: i64,
    },
}

/// Bytes of one encoded message, in consecutive segments.
#[derive(Clone, Debug)]
pub struct EncodedMessage {
    // The segments are shared, because the message is in the queue of each subscriber.
    segments: Arc<[Bytes]>,
    length: usize,
}

impl EncodedMessage {
    /// Returns the number of bytes.
    pub fn len(&self) -> usize {
        self.length
    }

    /// Returns whether there are no bytes.
    pub fn is_empty(&self) -> bool {
        self.length == 0
    }

    /// Returns the segments in order.
    pub fn segments(&self) -> &[Bytes] {
        &self.segments
    }

    /// Returns the bytes in one piece. Copies them if there are several segments.
    pub fn into_bytes(self) -> Bytes {
        match &*self.segments {
            [] => Bytes::new(),
            [segment] => segment.clone(),
            segments => segments.concat().into(),
        }
    }
}

impl From<Bytes> for EncodedMessage {
    fn from(bytes: Bytes) -> Self {
        Self { length: bytes.len(), segments: Arc::new([bytes]) }
    }
}

impl From<Vec<u8>> for EncodedMessage {
    fn from(bytes: Vec<u8>) -> Self {
        Bytes::from(bytes).into()
    }
}

/// Writes the fields of one message.
#[derive(Debug)]
pub struct Writer {
    form: WireForm,
    /// Bytes that do not belong to a finished segment yet.
    current_segment: BytesMut,
    segments: Vec<Bytes>,
    /// Number of bytes written after the encapsulation header. Alignment is counted from the end of this header.
    position: usize,
}

impl Writer {
    /// Creates a writer. For CDR it writes the encapsulation header.
    pub fn new(form: WireForm) -> Self {
        let mut current_segment = BytesMut::new();
        if form == WireForm::Cdr {
            current_segment.put_slice(&CDR_LITTLE_ENDIAN);
        }
        Self { form, current_segment, segments: Vec::new(), position: 0 }
    }

    /// Returns the wire form.
    pub fn form(&self) -> WireForm {
        self.form
    }

    /// Writes a number of `N` little-endian bytes, aligned if the form requires it.
    pub fn put_number<const N: usize>(&mut self, little_endian: [u8; N]) {
        if self.form == WireForm::Cdr {
            // A number is aligned to its own size, which is a power of two.
            let padding = self.position.wrapping_neg() & (N - 1);
            self.current_segment.put_bytes(0, padding);
            self.position += padding;
        }
        self.current_segment.put_slice(&little_endian);
        self.position += N;
    }

    /// Writes the number of elements of a sequence.
    ///
    /// # Errors
    /// If the number has more than 32 bits.
    pub fn put_length(&mut self, length: usize) -> Result<(), EncodeError> {
        let length_u32 = u32::try_from(length).map_err(|_| EncodeError::TooLong { length })?;
        self.put_number(length_u32.to_le_bytes());
        Ok(())
    }

    /// Writes a text.
    ///
    /// # Errors
    /// If the text is too long, or contains a NUL in CDR.
    pub fn put_text(&mut self, text: &str) -> Result<(), EncodeError> {
        match self.form {
            WireForm::Ros1 => self.put_length(text.len())?,
            WireForm::Cdr if text.contains('\0') => {
                return Err(EncodeError::NulInText { text: text.to_owned() });
            }
            // The length in CDR includes the closing NUL.
            WireForm::Cdr => self.put_length(text.len() + 1)?,
        }
        self.put_octets(text.as_bytes());
        if self.form == WireForm::Cdr {
            self.put_octets(&[0]);
        }
        Ok(())
    }

    /// Writes a sequence of bytes with its length. A long sequence becomes a segment and is not copied.
    ///
    /// # Errors
    /// If the sequence has too many bytes.
    pub fn put_bytes(&mut self, bytes: &Bytes) -> Result<(), EncodeError> {
        self.put_length(bytes.len())?;
        if bytes.len() < MIN_SEGMENT_BYTES {
            self.put_octets(bytes);
        } else {
            self.end_segment();
            self.segments.push(bytes.clone());
            self.position += bytes.len();
        }
        Ok(())
    }

    /// Writes bytes without alignment.
    fn put_octets(&mut self, bytes: &[u8]) {
        self.current_segment.put_slice(bytes);
        self.position += bytes.len();
    }

    fn end_segment(&mut self) {
        if !self.current_segment.is_empty() {
            self.segments.push(self.current_segment.split().freeze());
        }
    }

    /// Returns the encoded message.
    pub fn finish(mut self) -> EncodedMessage {
        self.end_segment();
        let length = self.segments.iter().map(Bytes::len).sum();
        EncodedMessage { segments: self.segments.into(), length }
    }
}
