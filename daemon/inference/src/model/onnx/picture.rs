//! Conversion of a picture to an input of the model.

use std::ops::Range;

use peernet_imaging::ImageError;
use peernet_sample::{Part, PixelFormat};
use peernet_statistics::number::counted;

use super::card::{Colour, Layout, Normalisation, PictureSource};
use super::geometry::{Geometry, PictureTransform};
use super::numbers::{Element, Numbers, for_elements};

/// Reason why a sample cannot be converted to the model's inputs.
#[derive(Debug, thiserror::Error)]
pub(super) enum InputError {
    /// The sample has no part.
    #[error("it has no payload")]
    NoPayload,
    /// The sample has fewer or more parts than the model has inputs.
    #[error("it has {}, the model takes {expected}: {names}", counted(*.actual as u64, "part"))]
    Parts {
        actual: usize,
        expected: usize,
        /// Names of the inputs, in the order of the parts.
        names: String,
    },
    /// A part is not a picture, or the picture cannot be decoded, resized, padded or cropped.
    #[error(transparent)]
    Picture(#[from] ImageError),
    /// The picture has another size than the input, and the card does not resize.
    #[error("it has {} × {} pixels, the model requires {} × {} and its card has no resize", .actual.0, .actual.1, .expected.0, .expected.1)]
    Size {
        /// Width and height of the picture, pixels.
        actual: (u32, u32),
        /// Width and height of the input, pixels.
        expected: (u32, u32),
    },
    /// A part is not an array.
    #[error(
        "it is {actual}, not an array with type and shape; in Python, return a numpy array of {expected}"
    )]
    NotAnArray {
        /// Media type of the part.
        actual: String,
        /// Type and shape of the input: `float32 [1, 7]`.
        expected: String,
    },
    /// The sample is a Python object with lists, numbers or dictionaries in it, instead of one part for each input.
    #[error(
        "it is an object of Python with lists, numbers or dictionaries in it; return {}{expected}",
        if *.is_tuple { "a tuple of: " } else { "" }
    )]
    PythonObject {
        /// Description of the parts to return, one for each input.
        expected: String,
        /// `true` if the model has several inputs.
        is_tuple: bool,
    },
    /// An array has another type or shape than the input.
    #[error("its array is {actual}, the model requires {expected}")]
    Array {
        /// Type and shape of the array: `float64 [7]`.
        actual: String,
        /// Type and shape of the input: `float32 [1, 7]`.
        expected: String,
    },
    /// An array has another number of bytes than its description says.
    #[error("its array has {actual} bytes, {expected} are needed for its type and shape")]
    Length { actual: u64, expected: u64 },
    /// One of several parts of a sample cannot be used.
    #[error("part {number} for input {input:?}: {error}")]
    Part {
        /// Position of the part, counted from 1.
        number: usize,
        input: String,
        error: Box<Self>,
    },
}

/// Converts pictures to numbers as the card defines. Buffers are reused for the next picture.
pub(super) struct PicturePreprocessor {
    geometry: Geometry,
    normalisation: PixelNormalisation,
    /// Result of reading the last picture, until this picture is converted.
    transform: Result<PictureTransform, InputError>,
}

/// Conversion of a picture's bytes to numbers.
struct PixelNormalisation {
    format: PixelFormat,
    layout: Layout,
    /// The channels of the input, in order.
    channels: Vec<Channel>,
}

/// Origin of the numbers of one channel of the input: `byte × factor + offset` for each pixel of the picture.
#[derive(Clone, Copy)]
struct Channel {
    /// Position of the byte in a pixel of the picture.
    byte_index: usize,
    factor: f32,
    offset: f32,
}

impl PicturePreprocessor {
    pub(super) fn new(source: &PictureSource) -> Self {
        Self {
            geometry: Geometry::new(source),
            normalisation: PixelNormalisation::new(source),
            // No picture has been read yet. `read` replaces this error.
            transform: Err(InputError::NoPayload),
        }
    }

    /// Reads the picture in a part, and resizes and crops it to the size of the input.
    pub(super) fn read(&mut self, part: &Part) {
        self.transform = self.geometry.apply(part, self.normalisation.format);
    }

    /// Converts the picture that was read last to the numbers of an input at `range`. Returns the relation between
    /// the picture and the input.
    ///
    /// # Errors
    /// If the picture could not be read.
    pub(super) fn normalise(
        &mut self,
        numbers: &mut Numbers,
        range: Range<usize>,
    ) -> Result<PictureTransform, InputError> {
        let transform = std::mem::replace(&mut self.transform, Err(InputError::NoPayload))?;
        let pixels = self.geometry.picture().pixels();
        for_elements!(numbers, elements => self.normalisation.apply(pixels, &mut elements[range]));
        Ok(transform)
    }
}

impl PixelNormalisation {
    fn new(source: &PictureSource) -> Self {
        let Normalisation { scale, mean, std } = &source.normalisation;
        let channel_count = mean.len();
        let channel = |(index, (mean, std)): (usize, (&f64, &f64))| Channel {
            byte_index: if source.colour == Colour::Bgr { channel_count - 1 - index } else { index },
            // `(byte × scale − mean) / std` as one multiplication and one addition.
            factor: (scale / std) as f32,
            offset: (-mean / std) as f32,
        };
        Self {
            format: if source.colour == Colour::Grey { PixelFormat::Grey8 } else { PixelFormat::Rgb8 },
            layout: source.layout,
            channels: mean.iter().zip(std).enumerate().map(channel).collect(),
        }
    }

    /// Converts bytes of interleaved channels to normalised numbers. Layout `nchw` takes one pass for each channel,
    /// which the compiler vectorises; layout `nhwc`, which is interleaved, takes one pass for all channels.
    fn apply<T: Element>(&self, pixels: &[u8], tensor: &mut [T]) {
        let channels = &self.channels[..];
        let channel_count = channels.len();
        match self.layout {
            Layout::Nchw => {
                let plane = tensor.len() / channel_count;
                for (numbers, channel) in tensor.chunks_exact_mut(plane).zip(channels) {
                    for (number, pixel) in numbers.iter_mut().zip(pixels.chunks_exact(channel_count)) {
                        *number = T::from_f32(
                            f32::from(pixel[channel.byte_index]) * channel.factor + channel.offset,
                        );
                    }
                }
            }
            Layout::Nhwc => {
                for (numbers, pixel) in
                    tensor.chunks_exact_mut(channel_count).zip(pixels.chunks_exact(channel_count))
                {
                    for (number, channel) in numbers.iter_mut().zip(channels) {
                        *number = T::from_f32(
                            f32::from(pixel[channel.byte_index]) * channel.factor + channel.offset,
                        );
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use peernet_sample::{Description, Sample};

    use super::super::card::Card;
    use super::super::card::tests::{SMALL, small_card_with};
    use super::*;

    fn pixels(format: PixelFormat, width: u32, height: u32, bytes: &'static [u8]) -> Part {
        Sample::from_part(Description::pixels(format, width, height), bytes.into()).parts.swap_remove(0)
    }

    /// Converts a picture as a card defines.
    fn convert(card: &Card, part: &Part) -> Result<Numbers, InputError> {
        let input = &card.inputs[0];
        let mut numbers = Numbers::zeros(input.data_type, input.element_count());
        let mut preprocessor = PicturePreprocessor::new(input.picture().expect("the input is a picture"));
        preprocessor.read(part);
        preprocessor.normalise(&mut numbers, 0..input.element_count())?;
        Ok(numbers)
    }

    #[test]
    fn numbers_are_scaled_and_normalised() {
        let card = Card::parse(SMALL).expect("the card is valid");
        let numbers = convert(&card, &pixels(PixelFormat::Grey8, 2, 1, &[10, 4])).expect("fits");
        assert_eq!(numbers, Numbers::Float32(vec![(10.0 * 0.5 - 1.0) / 2.0, (4.0 * 0.5 - 1.0) / 2.0]));
    }

    #[test]
    fn pixels_follow_layout_and_colour_of_card() {
        let convert_with = |layout: &str, shape: &str, colour: &str| {
            let card = SMALL
                .replace("layout = \"nchw\"", &format!("layout = \"{layout}\""))
                .replace("shape = [1, 1, 1, 2]", &format!("shape = {shape}"))
                .replace("colour = \"grey\"", &format!("colour = \"{colour}\""))
                .replace("scale = 0.5", "scale = 1.0")
                .replace("mean = [1.0]", "mean = [0.0, 0.0, 0.0]")
                .replace("std = [2.0]", "std = [1.0, 1.0, 1.0]");
            let card = Card::parse(&card).expect("the card is valid");
            convert(&card, &pixels(PixelFormat::Rgb8, 2, 1, &[1, 2, 3, 4, 5, 6])).expect("fits")
        };
        let floats = |numbers: [f32; 6]| Numbers::Float32(numbers.into());
        assert_eq!(convert_with("nchw", "[1, 3, 1, 2]", "rgb"), floats([1.0, 4.0, 2.0, 5.0, 3.0, 6.0]));
        assert_eq!(convert_with("nchw", "[1, 3, 1, 2]", "bgr"), floats([3.0, 6.0, 2.0, 5.0, 1.0, 4.0]));
        assert_eq!(convert_with("nhwc", "[1, 1, 2, 3]", "rgb"), floats([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
        assert_eq!(convert_with("nhwc", "[1, 1, 2, 3]", "bgr"), floats([3.0, 2.0, 1.0, 6.0, 5.0, 4.0]));
    }

    #[test]
    fn bytes_stay_as_they_are_without_normalisation() {
        let card = SMALL
            .replace("dtype = \"float32\"", "dtype = \"uint8\"")
            .replace("scale = 0.5\nmean = [1.0]\nstd = [2.0]", "");
        let card = Card::parse(&card).expect("the card is valid");
        let numbers = convert(&card, &pixels(PixelFormat::Grey8, 2, 1, &[0, 255])).expect("fits");
        assert_eq!(numbers, Numbers::Uint8(vec![0, 255]));
        // Some quantised models take the bytes minus 128.
        let signed = SMALL
            .replace("dtype = \"float32\"", "dtype = \"int8\"")
            .replace("scale = 0.5\nmean = [1.0]\nstd = [2.0]", "mean = [128.0]");
        let numbers = convert(
            &Card::parse(&signed).expect("the card is valid"),
            &pixels(PixelFormat::Grey8, 2, 1, &[0, 255]),
        );
        assert_eq!(numbers.expect("fits"), Numbers::Int8(vec![-128, 127]));
    }

    #[test]
    fn shortest_side_is_scaled_and_centre_cropped() {
        let card = small_card_with(
            "resize = { mode = \"exact\", width = 2, height = 1 }",
            "resize = { mode = \"shortest\", size = 2 }\ncrop = { width = 2, height = 1 }",
        );
        let wide = pixels(PixelFormat::Grey8, 8, 4, &[6; 32]);
        let numbers = convert(&card.expect("the card is valid"), &wide).expect("fits");
        assert_eq!(numbers, Numbers::Float32(vec![1.0, 1.0]));
    }

    #[test]
    fn wrong_size_without_resize_is_refused() {
        let card = small_card_with("resize = { mode = \"exact\", width = 2, height = 1 }", "")
            .expect("the card is valid");
        assert!(convert(&card, &pixels(PixelFormat::Grey8, 2, 1, &[1, 2])).is_ok());
        let error =
            convert(&card, &pixels(PixelFormat::Grey8, 1, 1, &[1])).expect_err("is too small").to_string();
        assert!(error.contains("1 × 1") && error.contains("2 × 1"), "{error}");
    }
}
