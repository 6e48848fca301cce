//! Connection headers: named texts that both sides send before messages.

use std::collections::BTreeMap;

use bytes::{BufMut, Bytes, BytesMut};
use thiserror::Error;

use super::MAX_HEADER_BYTES;

/// Maximum number of fields of a header. Clients send fewer than ten.
const MAX_FIELDS: usize = 100;

/// Error: bytes are not a connection header.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum HeaderError {
    /// A field extends beyond the header.
    #[error("a field of the connection header ends after the header")]
    TooShort,
    /// A field has no `=`.
    #[error("a field of the connection header has no '='")]
    NoSeparator,
    /// The header has too many fields.
    #[error("the connection header has more than {MAX_FIELDS} fields")]
    TooManyFields,
    /// A field is not UTF-8.
    #[error("a field of the connection header is not UTF-8")]
    NotUtf8,
    /// A required field is missing.
    #[error("the connection header does not contain the field {name}")]
    Missing {
        /// Name of the field.
        name: &'static str,
    },
}

/// The fields of a connection header.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ConnectionHeader {
    fields: BTreeMap<String, String>,
}

impl ConnectionHeader {
    /// Returns a header with the reason for refusing a connection.
    pub fn error(reason: &str) -> Self {
        Self::from_fields([("error", reason)])
    }

    /// Returns a header with the given fields.
    pub fn from_fields<'a>(fields: impl IntoIterator<Item = (&'a str, &'a str)>) -> Self {
        let fields = fields.into_iter().map(|(name, value)| (name.to_owned(), value.to_owned())).collect();
        Self { fields }
    }

    /// Returns the value of a field.
    pub fn get(&self, name: &str) -> Option<&str> {
        self.fields.get(name).map(String::as_str)
    }

    /// Returns the value of a required field.
    ///
    /// # Errors
    /// If the field is missing.
    pub fn require(&self, name: &'static str) -> Result<&str, HeaderError> {
        self.get(name).ok_or(HeaderError::Missing { name })
    }

    /// Reads the fields of a frame, whose length has been removed. If two fields have the same name, the last field is
    /// used.
    ///
    /// # Errors
    /// If the bytes are not a header.
    pub fn decode(mut frame: &[u8]) -> Result<Self, HeaderError> {
        let mut fields = BTreeMap::new();
        let mut count = 0;
        while !frame.is_empty() {
            count += 1;
            if count > MAX_FIELDS {
                return Err(HeaderError::TooManyFields);
            }
            let (prefix, after_prefix) = frame.split_first_chunk::<4>().ok_or(HeaderError::TooShort)?;
            let length = usize::try_from(u32::from_le_bytes(*prefix)).map_err(|_| HeaderError::TooShort)?;
            let (field, after_field) = after_prefix.split_at_checked(length).ok_or(HeaderError::TooShort)?;
            let field = std::str::from_utf8(field).map_err(|_| HeaderError::NotUtf8)?;
            // The first `=` separates name and value; a value may contain `=`, as in the constants of a definition.
            let (name, value) = field.split_once('=').ok_or(HeaderError::NoSeparator)?;
            fields.insert(name.to_owned(), value.to_owned());
            frame = after_field;
        }
        Ok(Self { fields })
    }

    /// Returns the bytes of the header, preceded by its length.
    ///
    /// A header that is too long for peers is sent without the definition of the message type, which is not needed to
    /// exchange messages.
    pub fn encode(&self) -> Bytes {
        let size = |fields: &[(&String, &String)]| -> usize {
            fields.iter().map(|(name, value)| 4 + name.len() + 1 + value.len()).sum()
        };
        let mut fields: Vec<(&String, &String)> = self.fields.iter().collect();
        if size(&fields) > MAX_HEADER_BYTES {
            fields.retain(|(name, _)| *name != "message_definition");
        }
        let length = size(&fields);
        let mut bytes = BytesMut::with_capacity(4 + length);
        let put_length = |bytes: &mut BytesMut, length: usize| {
            bytes.put_u32_le(u32::try_from(length).unwrap_or(u32::MAX));
        };
        put_length(&mut bytes, length);
        for (name, value) in fields {
            put_length(&mut bytes, name.len() + 1 + value.len());
            bytes.put_slice(name.as_bytes());
            bytes.put_u8(b'=');
            bytes.put_slice(value.as_bytes());
        }
        bytes.freeze()
    }
}
