//! The inputs of a model, which are filled with the numbers in the parts of a sample.

use std::borrow::Cow;
use std::ops::Range;

use ort::session::SessionInputValue;
use peernet_external::python::TREE;
use peernet_sample::{Description, ElementType, MediaType, Part, Sample};
use rayon::prelude::*;

use super::card::{Input, Source};
use super::data_type::DataType;
use super::geometry::PictureTransform;
use super::numbers::Numbers;
use super::picture::{InputError, PicturePreprocessor};

/// All inputs of a model, for one sample or for a batch. Buffers are reused.
pub(super) struct ModelInputs {
    inputs: Vec<InputBuffer>,
    /// For each sample of the largest batch, one preprocessor for each input that takes a picture.
    preprocessors: Vec<Vec<PicturePreprocessor>>,
    /// For each row of the batch, the relation between the first picture and the input that this picture fills.
    transforms: Vec<Option<PictureTransform>>,
}

/// One input with its numbers.
struct InputBuffer {
    input: Input,
    /// Numbers of all samples of the largest batch. A constant that all samples share is stored once.
    numbers: Numbers,
    /// Shape in the next run of the session.
    shape: Vec<usize>,
}

impl ModelInputs {
    /// Creates inputs for at most `max_size` samples. Constants have the numbers of the card; all other inputs are
    /// zeros. An input for which `is_batched` is true has one row for each sample.
    pub(super) fn new(inputs: &[Input], max_size: usize, is_batched: impl Fn(&Input) -> bool) -> Self {
        let buffer = |input: &Input| InputBuffer::new(input, if is_batched(input) { max_size } else { 1 });
        let preprocessors =
            || inputs.iter().filter_map(Input::picture).map(PicturePreprocessor::new).collect();
        Self {
            preprocessors: std::iter::repeat_with(preprocessors).take(max_size).collect(),
            inputs: inputs.iter().map(buffer).collect(),
            transforms: vec![None; max_size],
        }
    }

    /// Fills the inputs with the parts of the samples; the first part of a sample belongs to the first input of the
    /// card that is not a constant, and so on. The samples that can be used fill the first rows, in their order.
    /// Returns for each sample whether it can be used.
    ///
    /// # Errors
    /// A sample cannot be used if it has fewer or more parts than the model takes, or if an input cannot be made from
    /// its part. A model that takes one part ignores further parts.
    pub(super) fn fill(&mut self, samples: &[&Sample]) -> Vec<Result<(), InputError>> {
        let mut results: Vec<_> = samples.iter().map(|sample| self.check_parts(sample)).collect();
        self.read_pictures(samples);
        let mut row = 0;
        for (index, (result, sample)) in results.iter_mut().zip(samples).enumerate() {
            if result.is_ok() {
                *result = self.fill_row(row, sample, index);
                // The next sample overwrites the row of a sample that cannot be used, so that a run of the session
                // needs no unused rows.
                row += usize::from(result.is_ok());
            }
        }
        results
    }

    /// Checks that a sample has as many parts as the model takes.
    fn check_parts(&self, sample: &Sample) -> Result<(), InputError> {
        let part_buffers = || self.inputs.iter().filter(|buffer| buffer.is_filled_by_part());
        let is_python_object = |part: &Part| part.description.media.iana() == TREE;
        if sample.parts.iter().any(is_python_object) {
            let expected: Vec<String> = part_buffers().map(InputBuffer::describe_for_python).collect();
            let is_tuple = expected.len() > 1;
            return Err(InputError::PythonObject { expected: expected.join(", "), is_tuple });
        }
        let (actual, expected) = (sample.parts.len(), part_buffers().count());
        // A model of one input ignores further parts, such as the depth beside a picture.
        if actual < expected || (expected > 1 && actual > expected) {
            if actual == 0 {
                return Err(InputError::NoPayload);
            }
            let names: Vec<&str> = part_buffers().map(|buffer| buffer.input.name.as_str()).collect();
            return Err(InputError::Parts { actual, expected, names: names.join(", ") });
        }
        Ok(())
    }

    /// Reads the pictures of all samples and resizes them to the sizes of their inputs. Several files are read on
    /// several threads, because decoding takes most of the time before inference.
    fn read_pictures(&mut self, samples: &[&Sample]) {
        let takes_picture: Vec<bool> = self
            .inputs
            .iter()
            .filter(|buffer| buffer.is_filled_by_part())
            .map(InputBuffer::takes_picture)
            .collect();
        let mut unread: Vec<(&mut PicturePreprocessor, &Part)> = Vec::new();
        for (preprocessors, sample) in self.preprocessors.iter_mut().zip(samples) {
            let parts = sample.parts.iter().zip(&takes_picture).filter(|(_, takes_picture)| **takes_picture);
            unread.extend(preprocessors.iter_mut().zip(parts.map(|(part, _)| part)));
        }
        let files = unread.iter().filter(|(_, part)| is_file(part)).count();
        // A single file is read on this thread, and so are pixels, which are only copied: waking another thread would
        // take longer.
        if files > 1 {
            unread.into_par_iter().for_each(|(preprocessor, part)| preprocessor.read(part));
        } else {
            unread.into_iter().for_each(|(preprocessor, part)| preprocessor.read(part));
        }
    }

    /// Fills a row of all inputs with the parts of a sample. The preprocessors at `index` have read the pictures of
    /// this sample.
    fn fill_row(&mut self, row: usize, sample: &Sample, index: usize) -> Result<(), InputError> {
        self.transforms[row] = None;
        let mut preprocessors = self.preprocessors[index].iter_mut();
        let mut buffers: Vec<_> =
            self.inputs.iter_mut().filter(|buffer| buffer.is_filled_by_part()).collect();
        let count = buffers.len();
        for (position, (buffer, part)) in buffers.iter_mut().zip(&sample.parts).enumerate() {
            let preprocessor = if buffer.takes_picture() { preprocessors.next() } else { None };
            let range = buffer.range(row);
            let filled = match preprocessor {
                Some(preprocessor) => preprocessor.normalise(&mut buffer.numbers, range).map(Some),
                None => buffer.fill_from_array(range, part).map(|()| None),
            };
            // If there is only one input, the error need not name the part.
            let transform = filled.map_err(|error| match count {
                1 => error,
                _ => {
                    let input = buffer.input.name.clone();
                    InputError::Part { number: position + 1, input, error: Box::new(error) }
                }
            })?;
            // Boxes and pixels of an answer relate to the first picture of a sample.
            self.transforms[row] = self.transforms[row].or(transform);
        }
        Ok(())
    }

    /// Returns the relation between the first picture of a row and the input that this picture fills; `None` without a
    /// picture.
    pub(super) fn transform(&self, row: usize) -> Option<&PictureTransform> {
        self.transforms[row].as_ref()
    }

    /// Returns the name and the numbers of each input, for a run of the session with the first `size` samples. The
    /// numbers are not copied.
    pub(super) fn values(&mut self, size: usize) -> ort::Result<Vec<(Cow<'_, str>, SessionInputValue<'_>)>> {
        for buffer in self.inputs.iter_mut().filter(|buffer| buffer.is_batched()) {
            buffer.shape[0] = size;
        }
        self.inputs.iter().map(InputBuffer::value).collect()
    }
}

impl InputBuffer {
    fn new(input: &Input, rows: usize) -> Self {
        let mut numbers = Numbers::zeros(input.data_type, input.element_count() * rows);
        if let Source::Constant(values) = &input.source {
            numbers.fill(values);
        }
        Self { input: input.clone(), numbers, shape: input.shape.clone() }
    }

    /// Returns the name and the numbers for the next run of the session.
    fn value(&self) -> ort::Result<(Cow<'_, str>, SessionInputValue<'_>)> {
        Ok((Cow::Borrowed(self.input.name.as_str()), self.numbers.as_input(&self.shape)?))
    }

    fn is_filled_by_part(&self) -> bool {
        !matches!(self.input.source, Source::Constant(_))
    }

    /// Returns whether the input has a row for each sample of a batch.
    fn is_batched(&self) -> bool {
        // If the largest batch has one sample, the result is `false`: the shape in the card then needs no change.
        self.numbers.len() > self.input.element_count()
    }

    fn takes_picture(&self) -> bool {
        self.input.picture().is_some()
    }

    /// Returns the range of the numbers of a row.
    fn range(&self, row: usize) -> Range<usize> {
        let count = self.input.element_count();
        row * count..(row + 1) * count
    }

    /// Returns the description of the array that fills a row.
    fn array_description(&self) -> Description {
        self.input.data_type.array(&self.input.shape)
    }

    /// Returns what a sensor in Python must return for this input, for the text of an error.
    fn describe_for_python(&self) -> String {
        let name = &self.input.name;
        if self.takes_picture() {
            format!("for {name:?} a PIL image, or a JPEG or PNG as bytes")
        } else {
            format!("for {name:?} a numpy array of {}", describe_array(&self.array_description()))
        }
    }

    fn fill_from_array(&mut self, range: Range<usize>, part: &Part) -> Result<(), InputError> {
        let Part { description, bytes } = part;
        let expected = self.array_description();
        if description.media != MediaType::Tensor {
            let actual = description.media.iana().into_owned();
            return Err(InputError::NotAnArray { actual, expected: describe_array(&expected) });
        }
        if *description != expected {
            return Err(InputError::Array {
                actual: describe_array(description),
                expected: describe_array(&expected),
            });
        }
        let (actual, expected) = (bytes.len() as u64, expected.shaped_bytes().unwrap_or(u64::MAX));
        if actual != expected {
            return Err(InputError::Length { actual, expected });
        }
        self.numbers.read(range, bytes);
        Ok(())
    }
}

/// Returns whether a part is a file that has to be decoded.
fn is_file(part: &Part) -> bool {
    matches!(part.description.media, MediaType::Jpeg | MediaType::Png)
}

/// Returns the type and the shape of an array as a card writes them: `float32 [1, 7]`.
fn describe_array(Description { shape, element, .. }: &Description) -> String {
    let name = |element: &ElementType| match DataType::from_element(*element) {
        Some(data_type) => format!("{data_type} "),
        None => format!("{element:?} ").to_lowercase(),
    };
    format!("{}{shape:?}", element.as_ref().map_or_else(String::new, name))
}

#[cfg(test)]
mod tests {
    use peernet_imaging::{Encoding, Picture, encode};
    use peernet_sample::PixelFormat;

    use super::super::card::tests::{POLICY, small_card_with};
    use super::super::card::{Card, ModelCardError};
    use super::*;

    fn pixels(format: PixelFormat, width: u32, bytes: &'static [u8]) -> Part {
        Part { description: Description::pixels(format, width, 1), bytes: bytes.into() }
    }

    fn array(element: ElementType, shape: &[u32], bytes: Vec<u8>) -> Part {
        let description =
            Description { media: MediaType::Tensor, shape: shape.to_vec(), element: Some(element) };
        Part { description, bytes: bytes.into() }
    }

    fn sample(parts: Vec<Part>) -> Sample {
        Sample { parts, source: String::new(), label: None }
    }

    fn state() -> Part {
        array(ElementType::F64, &[2], [0.5_f64, -1.0].into_iter().flat_map(f64::to_le_bytes).collect())
    }

    /// Returns the inputs of a card for one sample, without rows for a batch.
    fn inputs_for_one_sample(card: Result<Card, ModelCardError>) -> ModelInputs {
        let is_batched = |_: &Input| false;
        ModelInputs::new(&card.expect("the card is valid").inputs, 1, is_batched)
    }

    fn parts() -> Vec<Part> {
        let front = pixels(PixelFormat::Rgb8, 2, &[1, 2, 3, 4, 5, 6]);
        vec![front, state(), pixels(PixelFormat::Grey8, 2, &[7, 8])]
    }

    #[test]
    fn parts_fill_inputs_in_order_of_card() {
        let mut inputs = inputs_for_one_sample(Card::parse(POLICY));
        inputs.fill(&[&sample(parts())]).remove(0).expect("fits");
        let numbers: Vec<&Numbers> = inputs.inputs.iter().map(|buffer| &buffer.numbers).collect();
        assert_eq!(
            numbers,
            [
                &Numbers::Uint8(vec![1, 2, 3, 4, 5, 6]),
                &Numbers::Float64(vec![0.5, -1.0]),
                &Numbers::Float32(vec![14.0, 16.0]),
                &Numbers::Int64(vec![3, 4]),
            ]
        );
        assert_eq!(inputs.transform(0).expect("the first picture has a transform").picture, (2, 1));
    }

    #[test]
    fn part_that_does_not_fit_is_named() {
        let mut inputs = inputs_for_one_sample(Card::parse(POLICY));
        let mut refusal = |change: &dyn Fn(&mut Vec<Part>)| {
            let mut changed = parts();
            change(&mut changed);
            inputs.fill(&[&sample(changed)]).remove(0).expect_err("does not fit").to_string()
        };
        let replace_state = |part: Part| move |parts: &mut Vec<Part>| parts[1] = part.clone();
        for (error, expected) in [
            (refusal(&|parts| parts.truncate(2)), "it has 2 parts, the model takes 3: front, state, wrist"),
            (refusal(&|parts| parts.clear()), "it has no payload"),
            (
                refusal(&replace_state(array(ElementType::F32, &[2], vec![0; 8]))),
                "part 2 for input \"state\": its array is float32 [2], the model requires float64 [2]",
            ),
            (
                refusal(&replace_state(array(ElementType::F64, &[2], vec![0; 8]))),
                "part 2 for input \"state\": its array has 8 bytes, 16 are needed for its type and shape",
            ),
            (
                refusal(&replace_state(parts().swap_remove(0))),
                "part 2 for input \"state\": it is image/x-rgb8, not an array",
            ),
            (
                refusal(&|parts| parts.swap(1, 2)),
                "part 2 for input \"state\": it is image/x-grey8, not an array",
            ),
            (
                refusal(&|parts| parts[2] = state()),
                "part 3 for input \"wrist\": it is an array, not a picture",
            ),
        ] {
            assert!(error.starts_with(expected), "{error}");
        }
    }

    #[test]
    fn python_object_is_refused_with_expected_values() {
        let tree = || Description::unshaped(MediaType::Other(TREE.to_owned()));
        let part = Part { description: tree(), bytes: b"{}".to_vec().into() };
        let mut inputs = inputs_for_one_sample(Card::parse(POLICY));
        let mut refusal = |parts: Vec<Part>| {
            inputs.fill(&[&sample(parts)]).remove(0).expect_err("does not fit").to_string()
        };
        // The number of parts is that of the model, so that only the type of the first part is wrong.
        assert_eq!(
            refusal([vec![part.clone()], parts()[..2].to_vec()].concat()),
            "it is an object of Python with lists, numbers or dictionaries in it; return a tuple of: for \"front\" a PIL image, or a \
             JPEG or PNG as bytes, for \"state\" a numpy array of float64 [2], for \"wrist\" a PIL image, or a JPEG or PNG as bytes"
        );
        let mut single_input = inputs_for_one_sample(small_card_with("", ""));
        let error = single_input.fill(&[&sample(vec![part])]).remove(0).expect_err("wrong").to_string();
        assert!(
            error.contains("in it; return for \"")
                && error.ends_with("a PIL image, or a JPEG or PNG as bytes"),
            "{error}"
        );
        let list =
            Part { description: Description::unshaped(MediaType::Json), bytes: b"[0.0]".to_vec().into() };
        let error = refusal(vec![parts().swap_remove(0), list, parts().swap_remove(2)]);
        let expected = "not an array with type and shape; in Python, return a numpy array of float64 [2]";
        assert!(error.contains("json") && error.ends_with(expected), "{error}");
    }

    #[test]
    fn payload_without_picture_is_refused() {
        let mut inputs = inputs_for_one_sample(small_card_with("", ""));
        let mut fill = |sample: &Sample| inputs.fill(&[sample]).remove(0).expect_err("wrong").to_string();
        assert_eq!(fill(&sample(Vec::new())), "it has no payload");
        let plain = Sample::from_part(Description::bytes(), vec![0; 4].into());
        assert_eq!(fill(&plain), "it is plain bytes, not a picture");
    }

    #[test]
    fn unusable_samples_leave_no_empty_rows_in_batch() {
        let card = small_card_with("", "").expect("the card is valid");
        let file = |grey: u8| {
            let picture = Picture::new(PixelFormat::Grey8, 2, 1, vec![grey, grey]).expect("fits");
            sample(vec![encode(&picture, Encoding::Png).expect("fits")])
        };
        let mut damaged = file(0);
        damaged.parts[0].bytes = damaged.parts[0].bytes.slice(..20);
        let batch = [file(4), damaged, sample(Vec::new()), file(10), file(8)];
        let mut inputs = ModelInputs::new(&card.inputs, batch.len(), |_| true);
        let results = inputs.fill(&batch.each_ref());
        assert_eq!(results.iter().map(Result::is_ok).collect::<Vec<_>>(), [true, false, false, true, true]);
        // (4 × 0.5 − 1) / 2 = 0.5, and so on.
        let Numbers::Float32(numbers) = &inputs.inputs[0].numbers else { panic!("has floats") };
        assert_eq!(numbers[..6], [0.5, 0.5, 2.0, 2.0, 1.5, 1.5]);
    }
}
