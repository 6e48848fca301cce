//! Changes of a picture's orientation and size before inference, and the conversion of points of the input to points of
//! the picture.

use peernet_imaging::{
    Crop, Orientation, Padding, Picture, Resizer, Scaling, crop, pad, read_part, turn_upright,
};
use peernet_sample::{Part, PixelFormat};

use super::card::{CentreCrop, PictureSource, Resize};
use super::picture::InputError;

/// Steps that change a picture's orientation and size. Their buffers are reused for the next picture.
pub(super) struct Geometry {
    orientation: Orientation,
    resize: Option<Resize>,
    crop: Option<CentreCrop>,
    /// Width and height of the model's input, pixels.
    input_size: (u32, u32),
    resizer: Resizer,
    decoded: Picture,
    resized: Picture,
    padded: Picture,
    cropped: Picture,
    /// Step whose buffer holds the picture in the size of the input.
    last_step: LastStep,
}

/// Step that changed a picture last.
#[derive(Clone, Copy)]
enum LastStep {
    Decode,
    Resize,
    Pad,
    Crop,
}

/// Relation between the pixels of a sample's picture and the pixels of the model's input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PictureTransform {
    /// Width and height of the picture in its final orientation, pixels.
    pub(super) picture: (u32, u32),
    /// Width and height of the input, pixels.
    pub(super) input: (u32, u32),
    /// Horizontal and vertical factor of the resizing.
    scale: (f32, f32),
    /// Position of the picture's upper left corner in the input, pixels.
    offset: (f32, f32),
}

impl PictureTransform {
    /// Returns the point of the picture that became the point `(x, y)` of the input. It may be outside of the picture.
    pub(super) fn to_picture(self, (x, y): (f32, f32)) -> (f32, f32) {
        ((x - self.offset.0) / self.scale.0, (y - self.offset.1) / self.scale.1)
    }

    /// Returns the point of the input that the point `(x, y)` of the picture became. It may be outside of the input.
    pub(super) fn to_input(self, (x, y): (f32, f32)) -> (f32, f32) {
        (x * self.scale.0 + self.offset.0, y * self.scale.1 + self.offset.1)
    }
}

impl Geometry {
    pub(super) fn new(source: &PictureSource) -> Self {
        let steps = &source.preprocessing;
        Self {
            orientation: steps.orientation,
            resize: steps.resize,
            crop: steps.crop,
            input_size: source.size,
            resizer: Resizer::new(),
            decoded: Picture::default(),
            resized: Picture::default(),
            padded: Picture::default(),
            cropped: Picture::default(),
            last_step: LastStep::Decode,
        }
    }

    /// Reads a picture and applies the steps. Afterwards, [`picture`](Self::picture) returns the picture in the size of
    /// the input.
    pub(super) fn apply(&mut self, part: &Part, format: PixelFormat) -> Result<PictureTransform, InputError> {
        self.last_step = LastStep::Decode;
        read_part(part, format, &mut self.decoded)?;
        if self.orientation == Orientation::Exif {
            turn_upright(part, &mut self.decoded)?;
        }
        let mut picture = &self.decoded;
        let original = size(picture);
        let mut offset = (0.0, 0.0);
        if let Some(resize) = self.resize {
            let (width, height, scaling) = target_size(resize, original);
            // A picture that already has the target size is not copied.
            if (width, height) != original {
                self.resizer.resize(picture, width, height, scaling, &mut self.resized)?;
                picture = &self.resized;
                self.last_step = LastStep::Resize;
            }
        }
        let resized = size(picture);
        if let Some(padding) = self.resize.and_then(|resize| padding(resize, resized)) {
            pad(picture, padding, &mut self.padded)?;
            picture = &self.padded;
            self.last_step = LastStep::Pad;
            offset = (padding.x as f32, padding.y as f32);
        }
        if let Some(centre_crop) = self.crop {
            let rectangle = centre_rectangle(centre_crop, picture);
            crop(picture, rectangle, &mut self.cropped)?;
            picture = &self.cropped;
            self.last_step = LastStep::Crop;
            // The crop moves the origin of the input into the picture.
            offset.0 -= rectangle.x.unwrap_or_default() as f32;
            offset.1 -= rectangle.y.unwrap_or_default() as f32;
        }
        let (actual, expected) = (size(picture), self.input_size);
        if actual != expected {
            return Err(InputError::Size { actual, expected });
        }
        let ratio = |resized: u32, original: u32| resized as f32 / original as f32;
        // The sides were rounded to whole pixels, so the factors are computed from the sides and not from the
        // configuration.
        let scale = (ratio(resized.0, original.0), ratio(resized.1, original.1));
        Ok(PictureTransform { picture: original, input: expected, scale, offset })
    }

    /// Returns the picture of the last [`apply`](Self::apply) that succeeded.
    pub(super) fn picture(&self) -> &Picture {
        match self.last_step {
            LastStep::Decode => &self.decoded,
            LastStep::Resize => &self.resized,
            LastStep::Pad => &self.padded,
            LastStep::Crop => &self.cropped,
        }
    }
}

fn size(picture: &Picture) -> (u32, u32) {
    (picture.width(), picture.height())
}

/// Returns the rectangle in the centre of a picture. If the picture is too small, `crop` refuses the rectangle.
fn centre_rectangle(CentreCrop { width, height, rounding }: CentreCrop, picture: &Picture) -> Crop {
    let first_margin = |whole: u32, part: u32| Some(rounding.first_margin(whole.saturating_sub(part)));
    Crop { width, height, x: first_margin(picture.width(), width), y: first_margin(picture.height(), height) }
}

/// Returns the size to which a picture of this width and height is resized, and the kind of scaling.
fn target_size(resize: Resize, (width, height): (u32, u32)) -> (u32, u32, Scaling) {
    match resize {
        Resize::Exact { width, height, filter, antialias } => (width, height, Scaling { filter, antialias }),
        Resize::Shortest { size, filter, antialias } => {
            // The product of two sides can exceed 32 bits.
            let (width, height) = (u64::from(width), u64::from(height));
            let shortest = width.min(height).max(1);
            let scaled = |side: u64| u32::try_from(side * u64::from(size) / shortest).unwrap_or(u32::MAX);
            (scaled(width), scaled(height), Scaling { filter, antialias })
        }
        Resize::Letterbox { width: max_width, height: max_height, filter, antialias, .. } => {
            let factor =
                (f64::from(max_width) / f64::from(width)).min(f64::from(max_height) / f64::from(height));
            // A very long picture keeps at least one pixel of its shorter side.
            let scaled =
                |side: u32, max: u32| ((f64::from(side) * factor).round() as u32).clamp(1, max.max(1));
            (scaled(width, max_width), scaled(height, max_height), Scaling { filter, antialias })
        }
    }
}

/// Returns the padding around a picture that was resized to this width and height; `None` if no padding is needed.
fn padding(resize: Resize, (resized_width, resized_height): (u32, u32)) -> Option<Padding> {
    let Resize::Letterbox { width, height, fill, position, .. } = resize else { return None };
    let first_margin = |whole: u32, part: u32| position.first_margin(whole.saturating_sub(part));
    let (x, y) = (first_margin(width, resized_width), first_margin(height, resized_height));
    ((resized_width, resized_height) != (width, height)).then_some(Padding { width, height, x, y, fill })
}

#[cfg(test)]
mod tests {
    use peernet_sample::{Description, Sample};
    use proptest::prelude::*;

    use super::super::card::Card;
    use super::super::card::tests::detector;
    use super::*;

    const OUTPUT: &str = "layout = 'yolov8'\nname = 'output0'";

    fn geometry(size: (u32, u32), resize: &str) -> Geometry {
        let card = detector(OUTPUT)
            .replace("shape = [1, 1, 2, 2]", &format!("shape = [1, 1, {}, {}]", size.1, size.0))
            .replace("resize = { mode = \"letterbox\", width = 2, height = 2 }", resize);
        Geometry::new(
            Card::parse(&card).expect("the card is valid").picture().expect("the input is a picture"),
        )
    }

    fn grey(width: u32, height: u32, bytes: Vec<u8>) -> Part {
        let description = Description::pixels(PixelFormat::Grey8, width, height);
        Sample::from_part(description, bytes.into()).parts.swap_remove(0)
    }

    #[test]
    fn letterbox_centres_picture_in_grey() {
        let mut geometry = geometry((4, 4), "resize = { mode = 'letterbox', width = 4, height = 4 }");
        let transform = geometry.apply(&grey(8, 2, vec![200; 16]), PixelFormat::Grey8).expect("fits");
        // The picture becomes 4 × 1 pixels, with one row of margin above and two rows below.
        let rows: Vec<&[u8]> = geometry.picture().pixels().chunks(4).collect();
        assert_eq!(rows, [[114; 4], [200; 4], [114; 4], [114; 4]]);
        assert_eq!(transform.to_picture((0.0, 1.0)), (0.0, 0.0));
        assert_eq!(transform.to_picture((4.0, 2.0)), (8.0, 2.0));
    }

    #[test]
    fn letterbox_enlarges_into_upper_left_corner() {
        let resize =
            "resize = { mode = 'letterbox', width = 4, height = 4, fill = 0, position = 'top-left' }";
        let mut geometry = geometry((4, 4), resize);
        let transform = geometry.apply(&grey(1, 2, vec![7, 7]), PixelFormat::Grey8).expect("fits");
        let picture = geometry.picture();
        assert!(picture.pixels().chunks(4).all(|row| row == [7, 7, 0, 0]), "{:?}", picture.pixels());
        assert_eq!(transform.to_picture((2.0, 4.0)), (1.0, 2.0));
    }

    #[test]
    fn crop_moves_points_back_by_its_margin() {
        let mut geometry =
            geometry((2, 2), "resize = { mode = 'shortest', size = 2 }\ncrop = { width = 2, height = 2 }");
        let transform = geometry.apply(&grey(12, 4, vec![0; 48]), PixelFormat::Grey8).expect("fits");
        // Resized to 6 × 2, of which the middle two columns remain.
        assert_eq!(transform.to_picture((0.0, 0.0)), (4.0, 0.0));
        assert_eq!(transform.to_picture((2.0, 2.0)), (8.0, 4.0));
    }

    proptest! {
        #[test]
        fn corners_of_any_picture_map_back(width in 1u32..400, height in 1u32..400) {
            let mut geometry = geometry((64, 48), "resize = { mode = 'letterbox', width = 64, height = 48 }");
            let part = grey(width, height, vec![0; (width * height) as usize]);
            let transform = geometry.apply(&part, PixelFormat::Grey8).expect("fits");
            for corner in [(0.0, 0.0), (width as f32, height as f32)] {
                let (x, y) = transform.to_input(corner);
                prop_assert!((-0.01..=64.01).contains(&x) && (-0.01..=48.01).contains(&y), "{x} {y}");
                let back = transform.to_picture((x, y));
                prop_assert!((back.0 - corner.0).abs() < 0.05 && (back.1 - corner.1).abs() < 0.05, "{back:?}");
            }
            let (right, bottom) = transform.to_input((width as f32, height as f32));
            let (left, top) = transform.to_input((0.0, 0.0));
            // The picture fills the input in one direction.
            prop_assert!(right - left > 63.0 || bottom - top > 47.0);
        }
    }
}
