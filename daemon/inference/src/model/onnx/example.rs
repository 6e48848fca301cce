//! A sample that a model accepts, to try the model without data.

use std::path::Path;

use bytes::Bytes;
use peernet_sample::{Description, Part, PixelFormat, Sample};

use super::CARD;
use super::card::{Card, Input, Source};
use crate::LoadError;

/// Width and height of a generated picture, pixels: a usual size of camera pictures.
const PICTURE_SIZE: (u32, u32) = (1280, 720);

/// Returns a sample with one part for each input that is not a constant: generated pixels for pictures, and zeros
/// for arrays.
///
/// # Errors
/// If the card is invalid.
pub(crate) fn example_sample(folder: &Path) -> Result<Sample, LoadError> {
    let card = Card::read(&folder.join(CARD))?;
    let parts = card.inputs.iter().filter_map(example_part).collect();
    Ok(Sample { parts, source: String::new(), label: None })
}

/// Returns a part for an input; `None` for a constant.
fn example_part(input: &Input) -> Option<Part> {
    match &input.source {
        Source::Picture(picture) => {
            // Without resizing, a picture of the input's size is always accepted, and a larger one only with a crop.
            let (width, height) =
                if picture.preprocessing.resize.is_some() { PICTURE_SIZE } else { picture.size };
            Some(pixels(width, height))
        }
        Source::Array => {
            let bytes = vec![0; input.element_count() * input.data_type.element().bytes() as usize];
            Some(Part { description: input.data_type.array(&input.shape), bytes: bytes.into() })
        }
        Source::Constant(_) => None,
    }
}

/// Returns uncompressed pixels of generated noise, so that nothing has to be decoded.
fn pixels(width: u32, height: u32) -> Part {
    // Multiplicative hashing with the prime 2,654,435,761, which is about 2³² divided by the golden ratio (D. E.
    // Knuth).
    let noise = |at: u32| (at.wrapping_mul(2_654_435_761) >> 24) as u8;
    let bytes: Bytes = (0..width * height * 3).map(noise).collect::<Vec<u8>>().into();
    Part { description: Description::pixels(PixelFormat::Rgb8, width, height), bytes }
}

#[cfg(test)]
mod tests {
    use super::super::card::tests::POLICY;
    use super::super::inputs::ModelInputs;
    use super::*;

    #[test]
    fn example_fits_inputs_of_its_card() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join(CARD), POLICY).expect("written");
        let sample = example_sample(folder.path()).expect("the card is right");
        assert_eq!(sample.parts.len(), 3);
        let card = Card::parse(POLICY).expect("the card is valid");
        let is_batched = |_: &Input| false;
        ModelInputs::new(&card.inputs, 1, is_batched).fill(&[&sample]).remove(0).expect("fits");
    }
}
