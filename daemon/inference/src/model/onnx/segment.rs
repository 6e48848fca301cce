//! Conversion of a segmentation's output to its answer.

use std::borrow::Cow;

use bytes::Bytes;
use peernet_sample::{Description, MediaType, Part, PixelFormat};
use serde::Serialize;

use super::card::Segmentation;
use super::geometry::PictureTransform;
use super::outputs::{Output, OutputError, Outputs};

/// First part of the answer, as JSON: `{"classes": [{"label": "road", "share": 0.61}, …], "class_count": 19, "width":
/// 1280, "height": 960}`. The second part has the number of each pixel's class.
#[derive(Debug, PartialEq, Serialize)]
struct Answer<'a> {
    /// The classes that the picture shows, the most frequent one first.
    classes: Vec<SegmentedClass<'a>>,
    /// Number of the model's classes. In the mask of a sample's label, a pixel with the value 255 has no class and is
    /// not scored; a pixel with any other value from `class_count` on has a class that the model does not have.
    class_count: usize,
    /// Width of the sample's picture, pixels.
    width: u32,
    /// Height of the sample's picture, pixels.
    height: u32,
}

#[derive(Debug, PartialEq, Serialize)]
struct SegmentedClass<'a> {
    label: &'a str,
    /// Fraction of the picture's pixels that have this class.
    share: f64,
}

/// The class of each pixel of the model's output.
struct ClassMap {
    width: usize,
    height: usize,
    classes: Vec<u8>,
}

/// Returns the two parts of the answer: the summary, and the class of each pixel of the sample's picture as one byte.
///
/// # Errors
/// If the output has another shape than the task needs, contains NaN, or names a class without label.
pub(super) fn segment(
    segmentation: &Segmentation,
    outputs: &Outputs<'_, '_>,
    transform: &PictureTransform,
) -> Result<Vec<Part>, OutputError> {
    let map = ClassMap::read(segmentation, outputs)?;
    let pixels = map.in_picture(transform);
    let mut counts = vec![0_u64; segmentation.labels.len()];
    for class in &pixels {
        counts[usize::from(*class)] += 1;
    }
    let share = |count: u64| count as f64 / pixels.len() as f64;
    let mut classes: Vec<_> = segmentation
        .labels
        .iter()
        .zip(counts)
        .filter(|(_, count)| *count > 0)
        .map(|(label, count)| SegmentedClass { label, share: share(count) })
        .collect();
    classes.sort_by(|a, b| b.share.total_cmp(&a.share));
    let (width, height) = transform.picture;
    let class_count = segmentation.labels.len();
    let json = serde_json::to_vec(&Answer { classes, class_count, width, height })?;
    Ok(vec![
        Part { description: Description::unshaped(MediaType::Json), bytes: Bytes::from(json) },
        Part {
            description: Description::pixels(PixelFormat::Grey8, width, height),
            bytes: Bytes::from(pixels),
        },
    ])
}

/// Checks the type and shape of the output for the zeros with which a session is warmed up. The numbers in this output
/// mean nothing and are not checked.
pub(super) fn check(segmentation: &Segmentation, outputs: &Outputs<'_, '_>) -> Result<(), OutputError> {
    match ClassMap::read(segmentation, outputs) {
        Ok(_) | Err(OutputError::NotANumber(_) | OutputError::UnknownClass { .. }) => Ok(()),
        Err(error) => Err(error),
    }
}

impl ClassMap {
    /// Reads one of two kinds of output: scores `[1, classes, height, width]`, where a pixel has the class with the
    /// largest score, or class numbers `[1, height, width]`, which are integers.
    fn read(segmentation: &Segmentation, outputs: &Outputs<'_, '_>) -> Result<Self, OutputError> {
        let output = outputs.get(&segmentation.name)?;
        let labels = segmentation.labels.len();
        if !output.data_type.is_float() {
            let [height, width] = output.unbatched("[1, height, width]")?;
            return Self::from_classes(&output, labels, (width, height));
        }
        let expected = format!("[1, {labels}, height, width]");
        let [count, height, width] = output.unbatched(&expected)?;
        if count != labels || width == 0 || height == 0 {
            return Err(output.wrong_shape(&expected));
        }
        let scores = output.numbers()?;
        // The scores of class 0 are the first candidates for the best scores.
        let mut best = scores[..width * height].to_vec();
        let mut classes = vec![0; width * height];
        // The scores are read class by class, because the scores of one class are contiguous.
        for (class, scores) in scores.chunks_exact(width * height).enumerate().skip(1) {
            for ((best, best_class), score) in best.iter_mut().zip(&mut classes).zip(scores) {
                if *score > *best {
                    (*best, *best_class) = (*score, class as u8);
                }
            }
        }
        Ok(Self { width, height, classes })
    }

    fn from_classes(
        output: &Output<'_>,
        labels: usize,
        (width, height): (usize, usize),
    ) -> Result<Self, OutputError> {
        if width == 0 || height == 0 {
            return Err(output.wrong_shape("[1, height, width]"));
        }
        let numbers: Cow<'_, [f32]> = output.numbers()?;
        let class = |number: &f32| {
            let class = *number as u8;
            if f32::from(class) == *number && usize::from(class) < labels {
                return Ok(class);
            }
            Err(OutputError::UnknownClass { name: output.name.to_owned(), class: *number, labels })
        };
        Ok(Self { width, height, classes: numbers.iter().map(class).collect::<Result<_, _>>()? })
    }

    /// Returns the class of each pixel of the picture: the class of that pixel of the output that contains the centre
    /// of the picture's pixel.
    fn in_picture(&self, transform: &PictureTransform) -> Vec<u8> {
        let (width, height) = transform.picture;
        let index = |position: f32, input: u32, length: usize| {
            // A float below 0 becomes 0.
            ((position * length as f32 / input as f32) as usize).min(length - 1)
        };
        let column = |x: u32| {
            let (x, _) = transform.to_input((x as f32 + 0.5, 0.0));
            index(x, transform.input.0, self.width)
        };
        let columns: Vec<usize> = (0..width).map(column).collect();
        let mut pixels = Vec::with_capacity(width as usize * height as usize);
        for y in 0..height {
            let (_, y) = transform.to_input((0.0, y as f32 + 0.5));
            let row = index(y, transform.input.1, self.height) * self.width;
            pixels.extend(columns.iter().map(|column| self.classes[row + column]));
        }
        pixels
    }
}
