//! Defects of model cards (`model.toml`).

use super::super::data_type::DataType;
use super::preprocessing::{Colour, Layout};

/// Defect in the text of a model card, the file `model.toml` that describes a model.
#[derive(Debug, thiserror::Error)]
pub(in crate::model::onnx) enum ModelCardError {
    /// The text is not TOML, or a key is missing, unknown or of another type.
    #[error("{}", .0.to_string().trim_end())]
    Toml(#[from] toml::de::Error),
    /// The model has no input.
    #[error("it has no [input]")]
    NoInput,
    /// Two inputs or outputs have the same name.
    #[error("{table} names {name:?} twice")]
    DuplicateName { table: &'static str, name: String },
    /// An input lacks a key of pictures.
    #[error("input {input:?} is a picture, but its {missing} is missing")]
    IncompletePicture { input: String, missing: &'static str },
    /// A picture has too few dimensions.
    #[error(
        "input.shape of picture {input:?} has {rank} lengths; a picture has the three of its layout, and before them 1 for the batch"
    )]
    Rank { input: String, rank: usize },
    /// The batch is larger than 1.
    #[error("input.shape has a batch of {0}; the batch must be 1")]
    Batch(usize),
    /// The number of channels contradicts the colours.
    #[error(
        "input.shape has {channels} channels with layout = \"{layout}\", but colour = \"{colour}\" has {expected}{}",
        other_layout(*.layout, *.fits_other)
    )]
    Channels {
        channels: usize,
        layout: Layout,
        colour: Colour,
        expected: usize,
        /// Whether the shape has the expected channels with the other layout.
        fits_other: bool,
    },
    /// Pixels are not truth values.
    #[error("input {0:?} is a picture of dtype bool; a picture has numbers")]
    PictureType(String),
    /// A constant has neither one number nor as many as its shape.
    #[error(
        "the key `value` of input {input:?} has {count} numbers; its shape needs {expected}, or one for all"
    )]
    ConstantLength { input: String, count: usize, expected: usize },
    /// A constant cannot be converted to the input's type without a change.
    #[error("the key `value` of input {input:?} has {value}, which is not a {data_type}")]
    ConstantValue { input: String, value: f64, data_type: DataType },
    /// A table for pictures has nothing to apply to.
    #[error(
        "[preprocessing] applies to no input, because none is a picture; an input becomes a picture with the keys layout and colour"
    )]
    NoPicture,
    /// A task needs a picture.
    #[error("task {0} needs an input that is a picture, with the keys layout and colour")]
    PictureTask(&'static str),
    /// The list does not have one number for each channel.
    #[error("preprocessing.{key} has {count} numbers for {channels} channels")]
    Numbers { key: &'static str, count: usize, channels: usize },
    /// A number cannot be used in the computation.
    #[error(
        "preprocessing.scale, mean and std are finite numbers; write the values with which the model was trained"
    )]
    NotFinite,
    /// A key is missing that an input of a floating-point type requires.
    #[error(
        "preprocessing.{0} is missing; only an input of integers has a default, which leaves bytes as they are"
    )]
    NoNormalisation(&'static str),
    /// A standard deviation is not positive.
    #[error(
        "preprocessing.std has {0}; a standard deviation is larger than 0, and 1.0 leaves the channel as it is"
    )]
    Deviation(f64),
    /// `scale` is zero.
    #[error(
        "preprocessing.scale must not be 0; write the factor of each byte, such as 0.003921569 for 1/255"
    )]
    NoScale,
    /// The size after preprocessing depends on the picture.
    #[error("preprocessing.resize to the shortest side needs a crop after it")]
    NoCrop,
    /// The crop is larger than the picture after resizing; width and height, pixels.
    #[error(
        "preprocessing.crop cuts out {} × {} pixels, but preprocessing.resize makes {made} pixels; write a larger size for resize",
        .crop.0, .crop.1
    )]
    Crop { crop: (u32, u32), made: String },
    /// The size after preprocessing differs from the size of the input; each is width and height, pixels.
    #[error("preprocessing makes {} × {} pixels, input.shape requires {} × {}", .made.0, .made.1, .wanted.0, .wanted.1)]
    Size { made: (u32, u32), wanted: (usize, usize) },
    /// There is no class to answer with.
    #[error("output.labels is empty; write one label for each class of the model")]
    NoLabels,
    /// An answer would have no class.
    #[error(
        "output.top_k is 0; write the number of classes that an answer lists, or leave the key out: it is then 5"
    )]
    NoListedClass,
    /// Two classes could not be distinguished in an answer.
    #[error("output.labels has {0:?} twice; each class needs a label of its own, such as \"{0} 2\"")]
    DuplicateLabel(String),
    /// An answer cannot have more classes than the model.
    #[error(
        "output.top_k is {top_k}, but the model has only {classes} labels; write top_k = {classes} or fewer"
    )]
    TopK { top_k: usize, classes: usize },
    /// A pixel of an answer has one byte.
    #[error("output.labels has {0} classes; a segmentation has at most 256")]
    TooManyClasses(usize),
    /// A key that the output's layout has is missing.
    #[error("output.{key} is missing; layout {layout:?} has the keys {expected}")]
    MissingKey { layout: &'static str, key: &'static str, expected: String },
    /// A key that the output's layout does not have.
    #[error("output.{key} is not a key of layout {layout:?}, which has {expected}")]
    SurplusKey { layout: &'static str, key: &'static str, expected: String },
    /// The scores of the layout's classes do not add up to 1.
    #[error("output.activation is \"softmax\"; layout {0:?} has \"none\" or \"sigmoid\"")]
    NoSoftmax(&'static str),
    /// A threshold is not a share.
    #[error("output.{key} is {value}; it is a number from 0 to 1")]
    Threshold { key: &'static str, value: f64 },
    /// `max_detections` is outside of 1 to 10,000.
    #[error("output.max_detections is {0}; it is a number from 1 to 10,000")]
    MaxDetections(usize),
    /// The task has no output.
    #[error("it has no [[output]]")]
    NoOutput,
}

/// Asks for the other layout if the shape fits it.
fn other_layout(layout: Layout, fits: bool) -> String {
    if fits { format!("; is layout = \"{}\" meant?", layout.other()) } else { String::new() }
}
