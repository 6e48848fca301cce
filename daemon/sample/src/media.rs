//! Media types as text: their IANA names.

use std::borrow::Cow;

use crate::{MediaType, PixelFormat};

const RGB8: &str = "image/x-rgb8";
const GREY8: &str = "image/x-grey8";
const TENSOR: &str = "application/x-tensor";

impl MediaType {
    /// Returns the IANA name, such as `image/jpeg`; a name with `x-` if IANA has registered none.
    pub fn iana(&self) -> Cow<'_, str> {
        Cow::Borrowed(match self {
            Self::Bytes => "application/octet-stream",
            Self::Jpeg => "image/jpeg",
            Self::Png => "image/png",
            Self::Pixels(PixelFormat::Rgb8) => RGB8,
            Self::Pixels(PixelFormat::Grey8) => GREY8,
            Self::Tensor => TENSOR,
            Self::Text => "text/plain",
            Self::Json => "application/json",
            Self::Other(name) => name,
        })
    }

    /// Returns the media type with an IANA name; case is ignored.
    pub fn from_iana(name: &str) -> Self {
        // Names of media types are not case-sensitive (RFC 2045, section 5.1).
        let lower = name.to_ascii_lowercase();
        match lower.as_str() {
            "application/octet-stream" => Self::Bytes,
            // `image/jpg` is not registered, but some programs write it.
            "image/jpeg" | "image/jpg" => Self::Jpeg,
            "image/png" => Self::Png,
            RGB8 => Self::Pixels(PixelFormat::Rgb8),
            GREY8 => Self::Pixels(PixelFormat::Grey8),
            TENSOR => Self::Tensor,
            "text/plain" => Self::Text,
            "application/json" => Self::Json,
            _ => Self::Other(lower),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip() {
        for media in [
            MediaType::Bytes,
            MediaType::Jpeg,
            MediaType::Png,
            MediaType::Pixels(PixelFormat::Rgb8),
            MediaType::Pixels(PixelFormat::Grey8),
            MediaType::Tensor,
            MediaType::Text,
            MediaType::Json,
            MediaType::Other("video/x-own".to_owned()),
        ] {
            assert_eq!(MediaType::from_iana(&media.iana()), media);
            assert_eq!(MediaType::from_iana(&media.iana().to_ascii_uppercase()), media);
        }
    }
}
