//! Conversion of a sample to the model's input.

use peernet_imaging::{
    Crop, ImageError, Orientation, Picture, Resizer, Scaling, crop, read_part, turn_upright,
};
use peernet_sample::{PixelFormat, Sample};

use super::card::{Card, CentreCrop, Colour, Layout, Preprocessing, Resize};

/// Reason that a sample cannot be converted to the model's input.
#[derive(Debug, thiserror::Error)]
pub(super) enum InputError {
    /// The sample has no part.
    #[error("it has no payload")]
    NoPayload,
    /// The first part is not a picture, or it cannot be decoded, resized or cropped.
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
}

/// Decodes, resizes, crops and normalises as the card defines; all buffers are reused for the next sample.
pub(super) struct Preprocessor {
    geometry: Geometry,
    normalisation: Normalisation,
    resizer: Resizer,
    decoded: Picture,
    resized: Picture,
    cropped: Picture,
    tensor: Vec<f32>,
}

/// Changes of a picture's orientation and size.
struct Geometry {
    orientation: Orientation,
    resize: Option<Resize>,
    crop: Option<CentreCrop>,
    /// Width and height of the model's input, pixels.
    expected: (u32, u32),
}

/// Conversion of a picture's bytes to numbers.
struct Normalisation {
    format: PixelFormat,
    layout: Layout,
    /// For each channel of the tensor: the channel of the picture, and factor and offset for its bytes.
    channels: Vec<Channel>,
}

#[derive(Clone, Copy)]
struct Channel {
    from: usize,
    factor: f32,
    offset: f32,
}

impl Preprocessor {
    pub(super) fn new(card: &Card) -> Self {
        let (_, count, height, width) = card.input.dimensions();
        let Preprocessing { orientation, resize, crop, .. } = card.preprocessing;
        Self {
            geometry: Geometry { orientation, resize, crop, expected: (width as u32, height as u32) },
            normalisation: Normalisation::new(card),
            resizer: Resizer::new(),
            decoded: Picture::default(),
            resized: Picture::default(),
            cropped: Picture::default(),
            tensor: vec![0.0; count * height * width],
        }
    }

    /// Returns the model's input, in the shape of the card; zeros before the first sample.
    pub(super) fn tensor(&self) -> &[f32] {
        &self.tensor
    }

    /// Converts the picture in a sample's first part to the model's input.
    pub(super) fn preprocess(&mut self, sample: &Sample) -> Result<(), InputError> {
        let part = sample.parts.first().ok_or(InputError::NoPayload)?;
        let Geometry { orientation, resize, crop: centre, expected } = self.geometry;
        read_part(part, self.normalisation.format, &mut self.decoded)?;
        if orientation == Orientation::Exif {
            turn_upright(part, &mut self.decoded)?;
        }
        let mut picture = &self.decoded;
        if let Some(resize) = resize {
            let (width, height, scaling) = target(resize, picture);
            if (width, height) != (picture.width(), picture.height()) {
                self.resizer.resize(picture, width, height, scaling, &mut self.resized)?;
                picture = &self.resized;
            }
        }
        if let Some(centre) = centre {
            crop(picture, rectangle(centre, picture), &mut self.cropped)?;
            picture = &self.cropped;
        }
        let actual = (picture.width(), picture.height());
        if actual != expected {
            return Err(InputError::Size { actual, expected });
        }
        self.normalisation.apply(picture.pixels(), &mut self.tensor);
        Ok(())
    }
}

/// Returns the rectangle in the centre of a picture. A picture that is too small is refused by the cropping.
fn rectangle(CentreCrop { width, height, rounding }: CentreCrop, picture: &Picture) -> Crop {
    let before = |whole: u32, part: u32| Some(rounding.before(whole.saturating_sub(part)));
    Crop { width, height, x: before(picture.width(), width), y: before(picture.height(), height) }
}

/// Returns the size to scale to, and the kind of scaling.
fn target(resize: Resize, picture: &Picture) -> (u32, u32, Scaling) {
    match resize {
        Resize::Exact { width, height, filter, antialias } => (width, height, Scaling { filter, antialias }),
        Resize::Shortest { size, filter, antialias } => {
            let (width, height) = (u64::from(picture.width()), u64::from(picture.height()));
            let shortest = width.min(height).max(1);
            let scaled = |side: u64| u32::try_from(side * u64::from(size) / shortest).unwrap_or(u32::MAX);
            (scaled(width), scaled(height), Scaling { filter, antialias })
        }
    }
}

impl Normalisation {
    fn new(card: &Card) -> Self {
        let (_, count, _, _) = card.input.dimensions();
        let preprocessing = &card.preprocessing;
        let channel = |(to, (mean, std)): (usize, (&f64, &f64))| Channel {
            from: if card.input.colour == Colour::Bgr { count - 1 - to } else { to },
            // `(byte × scale − mean) / std` as one multiplication and one addition.
            factor: (preprocessing.scale / std) as f32,
            offset: (-mean / std) as f32,
        };
        Self {
            format: if card.input.colour == Colour::Grey { PixelFormat::Grey8 } else { PixelFormat::Rgb8 },
            layout: card.input.layout,
            channels: preprocessing.mean.iter().zip(&preprocessing.std).enumerate().map(channel).collect(),
        }
    }

    /// Converts bytes of interleaved channels to normalised numbers: one pass for each channel (which the compiler
    /// vectorises) or, if the layout stays interleaved, one pass over all.
    fn apply(&self, pixels: &[u8], tensor: &mut [f32]) {
        let channels = &self.channels[..];
        let count = channels.len();
        match self.layout {
            Layout::Nchw => {
                let plane = tensor.len() / count;
                for (numbers, channel) in tensor.chunks_exact_mut(plane).zip(channels) {
                    for (number, pixel) in numbers.iter_mut().zip(pixels.chunks_exact(count)) {
                        *number = f32::from(pixel[channel.from]) * channel.factor + channel.offset;
                    }
                }
            }
            Layout::Nhwc => {
                for (numbers, pixel) in tensor.chunks_exact_mut(count).zip(pixels.chunks_exact(count)) {
                    for (number, channel) in numbers.iter_mut().zip(channels) {
                        *number = f32::from(pixel[channel.from]) * channel.factor + channel.offset;
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use peernet_sample::{Description, Sample};

    use super::super::card::tests::{SMALL, changed};
    use super::*;

    fn pixels(format: PixelFormat, width: u32, height: u32, bytes: &'static [u8]) -> Sample {
        Sample::from_part(Description::pixels(format, width, height), bytes.into())
    }

    #[test]
    fn numbers_are_scaled_and_normalised() {
        let mut preprocessor = Preprocessor::new(&changed("", "").expect("is right"));
        preprocessor.preprocess(&pixels(PixelFormat::Grey8, 2, 1, &[10, 4])).expect("fits");
        assert_eq!(preprocessor.tensor(), [(10.0 * 0.5 - 1.0) / 2.0, (4.0 * 0.5 - 1.0) / 2.0]);
    }

    #[test]
    fn pixels_follow_layout_and_colour_of_card() {
        let colour = |layout: &str, shape: &str, order: &str| {
            let card = SMALL
                .replace("layout = \"nchw\"", &format!("layout = \"{layout}\""))
                .replace("shape = [1, 1, 1, 2]", &format!("shape = {shape}"))
                .replace("colour = \"grey\"", &format!("colour = \"{order}\""))
                .replace("scale = 0.5", "scale = 1.0")
                .replace("mean = [1.0]", "mean = [0.0, 0.0, 0.0]")
                .replace("std = [2.0]", "std = [1.0, 1.0, 1.0]");
            let card = toml::from_str(&card).expect("is right");
            let mut preprocessor = Preprocessor::new(&card);
            preprocessor.preprocess(&pixels(PixelFormat::Rgb8, 2, 1, &[1, 2, 3, 4, 5, 6])).expect("fits");
            preprocessor.tensor().to_vec()
        };
        assert_eq!(colour("nchw", "[1, 3, 1, 2]", "rgb"), [1.0, 4.0, 2.0, 5.0, 3.0, 6.0]);
        assert_eq!(colour("nchw", "[1, 3, 1, 2]", "bgr"), [3.0, 6.0, 2.0, 5.0, 1.0, 4.0]);
        assert_eq!(colour("nhwc", "[1, 1, 2, 3]", "rgb"), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        assert_eq!(colour("nhwc", "[1, 1, 2, 3]", "bgr"), [3.0, 2.0, 1.0, 6.0, 5.0, 4.0]);
    }

    #[test]
    fn shortest_side_is_scaled_and_centre_cropped() {
        let card = changed(
            "resize = { mode = \"exact\", width = 2, height = 1 }",
            "resize = { mode = \"shortest\", size = 2 }\ncrop = { width = 2, height = 1 }",
        );
        let mut preprocessor = Preprocessor::new(&card.expect("is right"));
        let wide = pixels(PixelFormat::Grey8, 8, 4, &[6; 32]);
        preprocessor.preprocess(&wide).expect("fits");
        assert_eq!((preprocessor.resized.width(), preprocessor.resized.height()), (4, 2));
        assert_eq!(preprocessor.tensor(), [1.0, 1.0]);
    }

    #[test]
    fn wrong_size_without_resize_is_refused() {
        let card = changed("resize = { mode = \"exact\", width = 2, height = 1 }", "");
        let mut preprocessor = Preprocessor::new(&card.expect("is right"));
        assert!(preprocessor.preprocess(&pixels(PixelFormat::Grey8, 2, 1, &[1, 2])).is_ok());
        let error = preprocessor
            .preprocess(&pixels(PixelFormat::Grey8, 1, 1, &[1]))
            .expect_err("is too small")
            .to_string();
        assert!(error.contains("1 × 1") && error.contains("2 × 1"), "{error}");
    }

    #[test]
    fn payload_without_picture_is_refused() {
        let mut preprocessor = Preprocessor::new(&changed("", "").expect("is right"));
        let fill = |preprocessor: &mut Preprocessor, sample: &Sample| {
            preprocessor.preprocess(sample).expect_err("wrong").to_string()
        };
        let nothing = Sample { parts: Vec::new(), source: String::new(), label: None };
        assert_eq!(fill(&mut preprocessor, &nothing), "it has no payload");
        let plain = Sample::from_part(Description::bytes(), vec![0; 4].into());
        assert_eq!(fill(&mut preprocessor, &plain), "it is plain bytes, not a picture");
    }
}
