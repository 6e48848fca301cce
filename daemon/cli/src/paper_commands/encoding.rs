//! Encoding of pictures.

use peernet_sensors::TransformConfig;

/// Encoding in which pictures are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    /// Decoded pixels, as in the paper's program, which pickles the picture that its sensor opened.
    Pixels,
    /// The file as it is.
    File,
    /// Compressed again, at this quality.
    Jpeg(u8),
}

/// Reason why a text is not an encoding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum EncodingError {
    #[error("the quality of a JPEG is a number from 1 to 100")]
    Quality,
    #[error("use pixels, file or jpeg:QUALITY")]
    Unknown,
}

impl Encoding {
    pub(super) fn read(text: &str) -> Result<Self, EncodingError> {
        match (text, text.strip_prefix("jpeg:").map(str::parse)) {
            ("pixels", _) => Ok(Self::Pixels),
            ("file", _) => Ok(Self::File),
            (_, Some(Ok(quality @ 1..=100))) => Ok(Self::Jpeg(quality)),
            (_, Some(_)) => Err(EncodingError::Quality),
            _ => Err(EncodingError::Unknown),
        }
    }

    /// Returns the transforms of each picture.
    pub(super) fn transforms(self) -> Vec<TransformConfig> {
        match self {
            Self::Pixels => vec![TransformConfig::to_pixels()],
            Self::File => Vec::new(),
            Self::Jpeg(quality) => vec![TransformConfig::to_jpeg(quality)],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encodings_are_parsed() {
        assert_eq!(
            Encoding::read("pixels").map(Encoding::transforms),
            Ok(vec![TransformConfig::to_pixels()])
        );
        assert_eq!(Encoding::read("file").map(Encoding::transforms), Ok(Vec::new()));
        assert_eq!(Encoding::read("jpeg:85"), Ok(Encoding::Jpeg(85)));
        for wrong in ["jpeg", "jpeg:", "jpeg:0", "jpeg:101", "png", ""] {
            assert!(Encoding::read(wrong).is_err(), "{wrong}");
        }
    }
}
