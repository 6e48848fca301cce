//! Score of a segmentation: the mean ratio of intersection to union of the classes.
//!
//! M. Everingham et al., *The PASCAL Visual Object Classes Challenge: A Retrospective*, IJCV 111, 2015, section 2.3.3.

use peernet_sample::{MediaType, Part, PixelFormat, Sample};
use serde::Deserialize;

/// Name of the score of an iteration with a labelled mask: the ratio of intersection to union, as the mean over the
/// classes that the mask or the answer has.
pub const SEGMENTATION_SCORE: &str = "mean-iou";

/// Value of the pixels of a mask that are not scored, such as the border of an object (`void` of PASCAL VOC).
const IGNORED_CLASS: u8 = 255;

/// Number of different classes in one byte.
const CLASSES: usize = 256;

/// Class of each pixel of a picture, row by row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClassMap<'a> {
    width: usize,
    height: usize,
    classes: &'a [u8],
}

impl<'a> ClassMap<'a> {
    /// Creates the map; `None` if the picture is empty, or if there is not exactly one class for each pixel.
    pub fn new(width: u32, height: u32, classes: &'a [u8]) -> Option<Self> {
        let (width, height) = (width as usize, height as usize);
        (width > 0 && width.checked_mul(height)? == classes.len() && height > 0).then_some(Self {
            width,
            height,
            classes,
        })
    }

    /// Reads the answer of a segmentation: JSON, and grey pixels. Returns `None` if the answer has another form.
    pub fn from_answer(answer: &'a Sample) -> Option<Self> {
        let [_, pixels] = &answer.parts[..] else { return None };
        answer.json().and_then(|_| Self::from_part(pixels))
    }

    /// Reads grey pixels, such as a mask. Returns `None` if the part has another form.
    pub fn from_part(part: &'a Part) -> Option<Self> {
        let [height, width, 1] = part.description.shape[..] else { return None };
        let is_grey = part.description.media == MediaType::Pixels(PixelFormat::Grey8);
        is_grey.then(|| Self::new(width, height, &part.bytes))?
    }

    /// Returns whether this mask has a class that the model does not have. The number of the model's classes is read
    /// from the answer. Returns `false` if the answer does not contain it, like the answer of a Python object.
    pub fn has_unknown_class(&self, answer: &Sample) -> bool {
        let summary = answer.json().map(serde_json::from_slice);
        let Some(Ok(AnswerSummary { class_count: Some(count) })) = summary else { return false };
        self.classes.iter().any(|class| *class != IGNORED_CLASS && usize::from(*class) >= count)
    }
}

/// Key that is read from the first part of a segmentation's answer.
#[derive(Deserialize)]
struct AnswerSummary {
    class_count: Option<usize>,
}

/// Numbers of pixels of a class: in the mask, in the answer, and in both.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct ClassPixels {
    labelled: u64,
    answered: u64,
    /// Number of pixels that have the class both in the mask and in the answer.
    both: u64,
}

/// Numbers of pixels of each class, over one or several pictures.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SegmentedPixels(Box<[ClassPixels; CLASSES]>);

impl Default for SegmentedPixels {
    fn default() -> Self {
        Self(Box::new([ClassPixels::default(); CLASSES]))
    }
}

impl SegmentedPixels {
    /// Counts the pixels of a picture. The answer may have another resolution than the mask, with the same proportions.
    /// For each pixel of the mask, its class is compared with the class of the answer's pixel in which the centre of
    /// the mask's pixel lies.
    pub fn of(mask: ClassMap<'_>, answer: ClassMap<'_>) -> Self {
        let mut counts = Self::default();
        // Returns the index of the answer's pixel that contains the centre of the mask's pixel `index`, along one axis.
        // The sizes are the numbers of pixels along this axis. The calculation uses whole numbers, so that rounding
        // cannot choose a neighbouring pixel.
        let answer_index = |index: usize, mask_size: usize, answer_size: usize| {
            (2 * index + 1) * answer_size / (2 * mask_size)
        };
        let columns: Vec<usize> =
            (0..mask.width).map(|x| answer_index(x, mask.width, answer.width)).collect();
        for (y, labels) in mask.classes.chunks_exact(mask.width).enumerate() {
            let row_start = answer_index(y, mask.height, answer.height) * answer.width;
            for (label, column) in labels.iter().zip(&columns) {
                if *label == IGNORED_CLASS {
                    continue;
                }
                let answered = answer.classes[row_start + column];
                counts.0[usize::from(*label)].labelled += 1;
                counts.0[usize::from(answered)].answered += 1;
                counts.0[usize::from(*label)].both += u64::from(*label == answered);
            }
        }
        counts
    }

    /// Adds the pixels of other pictures.
    pub fn merge(&mut self, other: &Self) {
        for (class, more) in self.0.iter_mut().zip(other.0.iter()) {
            class.labelled += more.labelled;
            class.answered += more.answered;
            class.both += more.both;
        }
    }

    /// Returns the ratio of intersection to union, from 0 to 1, as the mean over the classes that occur in a mask or in
    /// an answer. `None` if no pixel is scored.
    pub fn mean_iou(&self) -> Option<f64> {
        let ratios: Vec<f64> = self.0.iter().filter_map(ClassPixels::iou).collect();
        (!ratios.is_empty()).then(|| ratios.iter().sum::<f64>() / ratios.len() as f64)
    }

    /// Returns the number of classes that a mask or an answer has.
    pub fn class_count(&self) -> usize {
        self.0.iter().filter_map(ClassPixels::iou).count()
    }
}

impl ClassPixels {
    /// Returns the ratio of intersection to union; `None` if neither the mask nor the answer has the class.
    fn iou(&self) -> Option<f64> {
        let union = self.labelled + self.answered - self.both;
        (union > 0).then(|| self.both as f64 / union as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(width: u32, classes: &[u8]) -> ClassMap<'_> {
        ClassMap::new(width, classes.len() as u32 / width, classes).expect("one class for each pixel")
    }

    #[test]
    fn mean_is_over_labelled_and_answered_classes() {
        // Pixels of the intersection and of the union: class 0: 2 of 3; class 1: 1 of 4; class 2: 0 of 2.
        let pixels = SegmentedPixels::of(map(3, &[0, 0, 0, 1, 1, 1]), map(3, &[0, 0, 1, 1, 2, 2]));
        let expected = (2.0 / 3.0 + 1.0 / 4.0 + 0.0) / 3.0;
        assert!((pixels.mean_iou().expect("is scored") - expected).abs() < 1e-12, "{:?}", pixels.mean_iou());
        assert_eq!(pixels.class_count(), 3);
        assert_eq!(SegmentedPixels::of(map(2, &[4, 9]), map(2, &[4, 9])).mean_iou(), Some(1.0));
    }

    #[test]
    fn ignored_pixels_are_not_scored() {
        let ignored = SegmentedPixels::of(map(4, &[255, 1, 1, 255]), map(4, &[0, 1, 1, 2]));
        assert_eq!((ignored.mean_iou(), ignored.class_count()), (Some(1.0), 1));
        assert_eq!(SegmentedPixels::of(map(1, &[255]), map(1, &[0])).mean_iou(), None);
    }

    #[test]
    fn answer_of_other_size_is_compared_by_place() {
        let mask = [0, 0, 1, 1, 0, 0, 1, 1, 2, 2, 3, 3, 2, 2, 3, 3];
        assert_eq!(SegmentedPixels::of(map(4, &mask), map(2, &[0, 1, 2, 3])).mean_iou(), Some(1.0));
        assert_eq!(SegmentedPixels::of(map(2, &[0, 1, 2, 3]), map(4, &mask)).mean_iou(), Some(1.0));
        // The middle row and column of this answer are class 9. Both middle rows of the mask have
        // their centres in the middle row of the answer, and the same holds for the columns. One of
        // the four pixels of each labelled class is therefore right, and no pixel of class 9.
        let cross = SegmentedPixels::of(map(4, &mask), map(3, &[0, 9, 1, 9, 9, 9, 2, 9, 3]));
        let expected = (4.0 * (1.0 / 4.0) + 0.0) / 5.0;
        assert_eq!((cross.class_count(), cross.mean_iou()), (5, Some(expected)));
    }

    #[test]
    fn pictures_are_scored_together() {
        let mut pixels = SegmentedPixels::of(map(1, &[0, 0, 0]), map(1, &[0, 0, 0]));
        pixels.merge(&SegmentedPixels::of(map(1, &[0]), map(1, &[1])));
        // Pixels of the intersection and of the union: class 0: 3 of 4; class 1: 0 of 1.
        assert_eq!(pixels.mean_iou(), Some(3.0 / 8.0));
    }

    #[test]
    fn maps_need_one_class_per_pixel() {
        assert_eq!(ClassMap::new(2, 2, &[0; 3]), None);
        assert_eq!(ClassMap::new(0, 2, &[]), None);
        assert_eq!(ClassMap::new(2, 0, &[]), None);
        assert_eq!(ClassMap::new(u32::MAX, u32::MAX, &[0]), None);
    }
}
