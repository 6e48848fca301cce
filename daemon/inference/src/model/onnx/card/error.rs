//! Defects of model cards (`model.toml`).

use super::super::data_type::DataType;
use super::preprocessing::{Colour, Layout};

/// Defect in the text of a model card, the file `model.toml` that describes a model.
#[derive(Debug, thiserror::Error)]
pub(in crate::model::onnx) enum ModelCardError {
    /// The text is not TOML, or a key is missing, unknown or of another type.
    #[error("{}", .0.to_string().trim_end())]
    Toml(#[from] toml::de::Error),
    /// The card has no input.
    #[error("it has no [input]")]
    NoInput,
    /// Two inputs or outputs have the same name.
    #[error("{table} names {name:?} twice")]
    DuplicateName { table: &'static str, name: String },
    /// A key is missing that every picture needs.
    #[error("input {input:?} is a picture, but its {missing} is missing")]
    IncompletePicture { input: String, missing: &'static str },
    /// A picture has too few dimensions.
    #[error(
        "input.shape of picture {input:?} has {rank} lengths; a picture has the three lengths of its layout, after a 1 for the batch"
    )]
    Rank { input: String, rank: usize },
    /// The batch is larger than 1.
    #[error("input.shape has a batch of {0}; the batch must be 1")]
    Batch(usize),
    /// The number of channels contradicts the colours.
    #[error(
        "input.shape has {channels} channels with layout = \"{layout}\", but colour = \"{colour}\" has {expected}{}",
        suggest_other_layout(*.layout, *.fits_other_layout)
    )]
    Channels {
        channels: usize,
        layout: Layout,
        colour: Colour,
        expected: usize,
        /// Whether the shape has the expected number of channels if it is read with the other layout.
        fits_other_layout: bool,
    },
    /// A picture has truth values as pixels.
    #[error("input {0:?} is a picture of dtype bool; a picture has numbers")]
    PictureType(String),
    /// An input is a constant and has keys of a picture.
    #[error(
        "input {0:?} is a constant, because it has the key `value`; a constant has no layout, colour or preprocessing"
    )]
    ConstantPicture(String),
    /// A constant has neither one number nor as many numbers as its shape has elements.
    #[error(
        "the key `value` of input {input:?} has {count} numbers; its shape needs {expected}, or one for all"
    )]
    ConstantLength { input: String, count: usize, expected: usize },
    /// The input's type cannot represent a number of a constant.
    #[error("the key `value` of input {input:?} has {value}, which the type {data_type} cannot represent")]
    ConstantValue { input: String, value: f64, data_type: DataType },
    /// The card has a table `[preprocessing]`, but no input is a picture.
    #[error(
        "[preprocessing] applies to no input, because none is a picture; an input becomes a picture with the keys layout and colour"
    )]
    NoPicture,
    /// A task needs a picture.
    #[error("task {0} needs an input that is a picture, with the keys layout and colour")]
    PictureTask(&'static str),
    /// A list does not have one number for each channel.
    #[error("preprocessing.{key} has {count} numbers; write one for each of the {channels} channels")]
    Numbers { key: &'static str, count: usize, channels: usize },
    /// A number of the normalisation is infinite or NaN.
    #[error(
        "preprocessing.scale, mean and std must be finite numbers; write the values with which the model was trained"
    )]
    NotFinite,
    /// A key is missing that an input of a floating-point type requires.
    #[error(
        "preprocessing.{0} is missing; only an input of integers has a default, which leaves bytes as they are"
    )]
    NoNormalisation(&'static str),
    /// A standard deviation is not positive.
    #[error(
        "preprocessing.std has {0}; a standard deviation must be larger than 0, and 1.0 leaves the channel as it is"
    )]
    Deviation(f64),
    /// `scale` is zero.
    #[error(
        "preprocessing.scale must not be 0; write the factor of each byte, such as 0.003921569 for 1/255"
    )]
    NoScale,
    /// The size after preprocessing depends on the picture.
    #[error(
        "preprocessing.resize with mode = \"shortest\" needs a crop, because the longer side depends on the picture"
    )]
    NoCrop,
    /// The crop is larger than the resized picture; `crop` is its width and height, pixels.
    #[error(
        "preprocessing.crop cuts out {} × {} pixels, but preprocessing.resize makes {resized} pixels; write a larger size for resize",
        .crop.0, .crop.1
    )]
    Crop { crop: (u32, u32), resized: String },
    /// The size after preprocessing differs from the size of the input; each is width and height, pixels.
    #[error("preprocessing makes {} × {} pixels, input.shape requires {} × {}", .actual.0, .actual.1, .expected.0, .expected.1)]
    Size { actual: (u32, u32), expected: (usize, usize) },
    /// The list of labels is empty.
    #[error("output.labels is empty; write one label for each class of the model")]
    NoLabels,
    /// `top_k` is 0, so an answer would list no class.
    #[error(
        "output.top_k is 0; write the number of classes that an answer lists, or leave the key out: it is then 5"
    )]
    NoListedClass,
    /// Two classes have the same label.
    #[error("output.labels has {0:?} twice; each class needs a label of its own, such as \"{0} 2\"")]
    DuplicateLabel(String),
    /// `top_k` is larger than the number of classes.
    #[error(
        "output.top_k is {top_k}, but the model has only {classes} labels; write top_k = {classes} or fewer"
    )]
    TopK { top_k: usize, classes: usize },
    /// A segmentation has more classes than the byte of a pixel can distinguish.
    #[error("output.labels has {0} classes; a segmentation has at most 256")]
    TooManyClasses(usize),
    /// A key that the output's layout has is missing.
    #[error("output.{key} is missing; layout {layout:?} has the keys {expected}")]
    MissingKey { layout: &'static str, key: &'static str, expected: String },
    /// A key that the output's layout does not have.
    #[error("output.{key} is not a key of layout {layout:?}, which has {expected}")]
    SurplusKey { layout: &'static str, key: &'static str, expected: String },
    /// The activation is softmax, but the scores of the layout's classes do not add up to 1.
    #[error("output.activation is \"softmax\"; layout {0:?} takes \"none\" or \"sigmoid\"")]
    NoSoftmax(&'static str),
    /// A threshold is not a number from 0 to 1.
    #[error("output.{key} is {value}; write a number from 0 to 1")]
    Threshold { key: &'static str, value: f64 },
    /// `max_detections` is outside of 1 to 10,000.
    #[error("output.max_detections is {0}; write a number from 1 to 10,000")]
    MaxDetections(usize),
    /// The card names no output for the task `tensors`.
    #[error("it has no [[output]]")]
    NoOutput,
}

/// Returns a question that names the other layout, if the shape fits that layout.
fn suggest_other_layout(layout: Layout, fits: bool) -> String {
    if fits { format!("; is layout = \"{}\" meant?", layout.other()) } else { String::new() }
}
