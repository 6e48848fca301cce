//! The card of a model, `model.toml`: the conversion of a picture to the model's input and of its output to an
//! answer.

use std::collections::HashSet;
use std::fmt;
use std::io::{self, Read};
use std::path::Path;

use peernet_imaging::{Filter, Orientation};
use serde::de::Error;
use serde::{Deserialize, Deserializer};

use super::regular_file;
use crate::LoadError;

/// Number of classes in an answer by default.
const LISTED: usize = 5;

/// Largest size of a card, bytes. A thousand labels take some ten kilobytes.
const MAX_CARD_BYTES: u64 = 1 << 20;

/// Card of a model. A new model needs a card and no code.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Card {
    pub(super) name: String,
    pub(super) task: Task,
    #[serde(default)]
    pub(super) description: String,
    #[serde(default)]
    pub(super) version: String,
    pub(super) input: Input,
    pub(super) preprocessing: Preprocessing,
    pub(super) output: Output,
    /// Origin of the model, for people, in any form.
    #[serde(default)]
    pub(super) provenance: toml::Table,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Task {
    Classification,
}

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Input {
    /// Name of the model's input.
    pub(super) name: String,
    dtype: DataType,
    pub(super) layout: Layout,
    /// Four lengths in the order of the layout; the first, the batch, is 1.
    #[serde(deserialize_with = "lengths")]
    pub(super) shape: [usize; 4],
    pub(super) colour: Colour,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum DataType {
    Float32,
}

/// Order of the input's dimensions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Layout {
    Nchw,
    Nhwc,
}

/// Order of the input's channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Colour {
    Rgb,
    Bgr,
    Grey,
}

/// Preprocessing steps, applied in the order of the fields: orientation, resize, crop, then `(byte × scale − mean) / std` for each
/// channel.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Preprocessing {
    /// Orientation of the picture before the other steps.
    #[serde(default)]
    pub(super) orientation: Orientation,
    /// Resizing. Without it pictures must have the size of the input.
    #[serde(default)]
    pub(super) resize: Option<Resize>,
    /// Rectangle that is cut out of the centre.
    #[serde(default)]
    pub(super) crop: Option<CentreCrop>,
    pub(super) scale: f64,
    /// One number per channel, in the order of `colour`.
    pub(super) mean: Vec<f64>,
    /// One number per channel, in the order of `colour`.
    pub(super) std: Vec<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(tag = "mode", rename_all = "lowercase", deny_unknown_fields)]
pub(super) enum Resize {
    /// Resizes to this size, without regard to the picture's proportions.
    Exact {
        width: u32,
        height: u32,
        #[serde(default)]
        filter: Filter,
        /// `true` to average over all source pixels when the picture becomes smaller.
        #[serde(default = "default_true")]
        antialias: bool,
    },
    /// Resizes the shorter side to this length, and the other side in proportion, rounded down. Pixels.
    Shortest {
        size: u32,
        #[serde(default)]
        filter: Filter,
        /// `true` to average over all source pixels when the picture becomes smaller.
        #[serde(default = "default_true")]
        antialias: bool,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CentreCrop {
    pub(super) width: u32,
    pub(super) height: u32,
    /// Position of the rectangle if the margins cannot be equal.
    #[serde(default)]
    pub(super) rounding: Rounding,
}

/// Rounding of the left and upper margins if half a pixel is left over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Rounding {
    /// Rounds down.
    #[default]
    Down,
    /// Rounds half to even, as torchvision does (Python's `round`).
    HalfEven,
}

impl Rounding {
    /// Returns the number of pixels before the crop if `margin` pixels are left over.
    pub(super) const fn before(self, margin: u32) -> u32 {
        match self {
            Self::HalfEven if margin % 4 == 3 => margin / 2 + 1,
            _ => margin / 2,
        }
    }
}

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Output {
    /// Name of the model's output.
    pub(super) name: String,
    #[serde(default)]
    pub(super) activation: Activation,
    /// Number of classes in an answer, best first. Default: five, or all if there are fewer.
    #[serde(default)]
    pub(super) top_k: Option<usize>,
    /// One label per number of the output.
    pub(super) labels: Vec<String>,
}

/// Function that turns the model's numbers into scores.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Activation {
    /// No function: the numbers are scores already.
    #[default]
    None,
    /// Softmax: the scores add up to 1, for exactly one right class.
    Softmax,
    /// Sigmoid: each score is between 0 and 1 on its own, for any number of right classes.
    Sigmoid,
}

/// Defect in the text of a card.
#[derive(Debug, thiserror::Error)]
pub(super) enum CardError {
    /// The text is not TOML, or a key is missing, unknown or of another type.
    #[error("{}", .0.to_string().trim_end())]
    Toml(#[from] toml::de::Error),
    /// The batch is larger than 1.
    #[error("input.shape has a batch of {0}; the batch must be 1")]
    Batch(usize),
    /// The number of channels contradicts the colours.
    #[error("input.shape has {channels} channels, {colour:?} has {expected}")]
    Channels { channels: usize, colour: Colour, expected: usize },
    /// The list does not have one number for each channel.
    #[error("preprocessing.{key} has {count} numbers for {channels} channels")]
    Numbers { key: &'static str, count: usize, channels: usize },
    /// A number cannot be used in the computation.
    #[error(
        "preprocessing.scale, mean and std are finite numbers; write the values with which the model was trained"
    )]
    NotFinite,
    /// A standard deviation is not positive.
    #[error(
        "preprocessing.std has {0}; a standard deviation is larger than 0, and 1.0 leaves the channel as it is"
    )]
    Deviation(f64),
    /// The size after preprocessing depends on the picture.
    #[error("preprocessing.resize to the shortest side needs a crop after it")]
    NoCrop,
    /// The size after preprocessing differs from the size of the input; each is width and height, pixels.
    #[error("preprocessing makes {} × {} pixels, input.shape requires {} × {}", .made.0, .made.1, .wanted.0, .wanted.1)]
    Size { made: (u32, u32), wanted: (usize, usize) },
    /// There is no class to answer with.
    #[error("output needs at least one label and a top_k of at least 1")]
    NoLabels,
    /// Two classes could not be distinguished in an answer.
    #[error("output.labels has {0:?} twice; each class needs a label of its own, such as \"{0} 2\"")]
    DuplicateLabel(String),
    /// An answer cannot have more classes than the model.
    #[error(
        "output.top_k is {top_k}, but the model has only {classes} labels; write top_k = {classes} or fewer"
    )]
    TopK { top_k: usize, classes: usize },
}

fn text(file: &Path) -> io::Result<String> {
    let mut file = regular_file::open(file)?;
    let length = file.metadata()?.len();
    if length > MAX_CARD_BYTES {
        return Err(io::Error::other(format!("it has {length} bytes, the limit is {MAX_CARD_BYTES}")));
    }
    let mut text = String::new();
    file.read_to_string(&mut text)?;
    Ok(text)
}

impl Card {
    /// Reads and checks a card.
    pub(super) fn read(file: &Path) -> Result<Self, LoadError> {
        let wrong = |reason: String| LoadError::File { file: file.to_owned(), reason };
        let text = text(file).map_err(|error| wrong(error.to_string()))?;
        Self::parse(&text).map_err(|error| wrong(error.to_string()))
    }

    fn parse(text: &str) -> Result<Self, CardError> {
        let card: Self = toml::from_str(text)?;
        card.check()?;
        Ok(card)
    }

    /// Checks the rules that the types do not express.
    fn check(&self) -> Result<(), CardError> {
        let Self { input, preprocessing, output, .. } = self;
        let (batch, channels, height, width) = input.dimensions();
        if batch != 1 {
            return Err(CardError::Batch(batch));
        }
        let expected = input.colour.channels();
        if channels != expected {
            return Err(CardError::Channels { channels, colour: input.colour, expected });
        }
        for (key, values) in [("mean", &preprocessing.mean), ("std", &preprocessing.std)] {
            if values.len() != channels {
                return Err(CardError::Numbers { key, count: values.len(), channels });
            }
        }
        let numbers = || preprocessing.mean.iter().chain(&preprocessing.std).chain([&preprocessing.scale]);
        if !numbers().all(|number| number.is_finite()) {
            return Err(CardError::NotFinite);
        }
        if let Some(deviation) = preprocessing.std.iter().find(|deviation| **deviation <= 0.0) {
            return Err(CardError::Deviation(*deviation));
        }
        let result = match (preprocessing.resize, preprocessing.crop) {
            (_, Some(CentreCrop { width, height, .. })) => Some((height, width)),
            (Some(Resize::Exact { width, height, .. }), None) => Some((height, width)),
            (Some(Resize::Shortest { .. }), None) => {
                return Err(CardError::NoCrop);
            }
            (None, None) => None,
        };
        if let Some((rows, columns)) = result
            && (rows as usize, columns as usize) != (height, width)
        {
            return Err(CardError::Size { made: (columns, rows), wanted: (width, height) });
        }
        output.check()
    }
}

impl Output {
    /// Returns the number of classes in an answer.
    pub(super) fn listed_classes(&self) -> usize {
        self.top_k.unwrap_or(LISTED).min(self.labels.len())
    }

    fn check(&self) -> Result<(), CardError> {
        if self.labels.is_empty() || self.top_k == Some(0) {
            return Err(CardError::NoLabels);
        }
        // Labels that differ in case alone are allowed: ImageNet has `cardigan`, a garment, and `Cardigan`, a dog.
        let mut seen = HashSet::new();
        if let Some(label) = self.labels.iter().find(|label| !seen.insert(label.as_str())) {
            return Err(CardError::DuplicateLabel(label.clone()));
        }
        match self.top_k {
            Some(top_k) if top_k > self.labels.len() => {
                Err(CardError::TopK { top_k, classes: self.labels.len() })
            }
            _ => Ok(()),
        }
    }
}

/// Deserialises the lengths of a shape. An exported model often has -1 or a name for a length that is open.
fn lengths<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[usize; 4], D::Error> {
    let lengths = <[toml::Value; 4]>::deserialize(deserializer)?;
    let mut shape = [0; 4];
    for (length, value) in shape.iter_mut().zip(&lengths) {
        *length = value
            .as_integer()
            .and_then(|number| usize::try_from(number).ok())
            .filter(|length| *length > 0)
            .ok_or_else(|| {
                D::Error::custom(format_args!(
                    "a length is {value}; write the length with which the model is run, and 1 for the batch"
                ))
            })?;
    }
    Ok(shape)
}

impl Input {
    /// Returns batch, channels, height and width.
    pub(super) fn dimensions(&self) -> (usize, usize, usize, usize) {
        let [batch, a, b, c] = self.shape;
        match self.layout {
            Layout::Nchw => (batch, a, b, c),
            Layout::Nhwc => (batch, c, a, b),
        }
    }
}

impl Colour {
    fn channels(self) -> usize {
        match self {
            Self::Rgb | Self::Bgr => 3,
            Self::Grey => 1,
        }
    }
}

impl fmt::Display for Layout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Nchw => "nchw",
            Self::Nhwc => "nhwc",
        })
    }
}

const fn default_true() -> bool {
    true
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Card for grey pictures of 2 × 1 pixels.
    pub(in crate::model::onnx) const SMALL: &str = r#"
name = "small"
task = "classification"
[input]
name = "image"
dtype = "float32"
layout = "nchw"
shape = [1, 1, 1, 2]
colour = "grey"
[preprocessing]
resize = { mode = "exact", width = 2, height = 1 }
scale = 0.5
mean = [1.0]
std = [2.0]
[output]
name = "logits"
activation = "softmax"
labels = ["a", "b"]
"#;

    pub(in crate::model::onnx) fn changed(from: &str, to: &str) -> Result<Card, CardError> {
        assert!(SMALL.contains(from), "{from}");
        Card::parse(&SMALL.replace(from, to))
    }

    #[test]
    fn card_is_read_with_its_defaults() {
        let card = changed("", "").expect("is right");
        assert_eq!(card.output.listed_classes(), 2, "all, because there are fewer than five");
        assert_eq!(
            card.preprocessing.resize,
            Some(Resize::Exact { width: 2, height: 1, filter: Filter::Bilinear, antialias: true })
        );
        assert!(Card::parse(&format!("{SMALL}\n[provenance]\nanything = [1, 2]\n")).is_ok());
    }

    #[test]
    fn odd_margin_is_split_as_configured() {
        let before = |rounding: Rounding| [0, 1, 2, 3, 4, 5, 7].map(|margin| rounding.before(margin));
        assert_eq!(before(Rounding::Down), [0, 0, 1, 1, 2, 2, 3]);
        // As `int(round(margin / 2.0))` computes in Python.
        assert_eq!(before(Rounding::HalfEven), [0, 0, 1, 2, 2, 2, 4]);
    }

    #[test]
    fn contradictory_keys_are_named() {
        for (from, to, named) in [
            ("shape = [1, 1, 1, 2]", "shape = [2, 1, 1, 2]", "batch of 2"),
            ("colour = \"grey\"", "colour = \"rgb\"", "1 channels"),
            ("mean = [1.0]", "mean = []", "mean has 0 numbers"),
            ("std = [2.0]", "std = [0.0]", "larger than 0"),
            ("std = [2.0]", "std = [-0.25]", "preprocessing.std has -0.25"),
            ("scale = 0.5", "scale = nan", "finite"),
            ("width = 2,", "width = 3,", "3 × 1 pixels"),
            ("mode = \"exact\", width = 2, height = 1", "mode = \"shortest\", size = 2", "needs a crop"),
            ("labels = [\"a\", \"b\"]", "labels = []", "at least one label"),
            ("labels = [\"a\", \"b\"]", "labels = [\"a\", \"b\", \"a\"]", "has \"a\" twice"),
            ("labels = [", "top_k = 3\nlabels = [", "write top_k = 2"),
            ("shape = [1, 1, 1, 2]", "shape = [-1, 1, 1, 2]", "a length is -1; write the length"),
            ("shape = [1, 1, 1, 2]", "shape = [\"batch\", 1, 1, 2]", "1 for the batch"),
            ("task = \"classification\"", "task = \"detection\"", "classification"),
            ("dtype = \"float32\"", "dtype = \"float16\"", "float32"),
            ("scale = 0.5", "scale = 0.5\nmeans = [1.0]", "means"),
        ] {
            let error = changed(from, to).expect_err(to).to_string();
            assert!(error.contains(named), "{to}: {error}");
        }
    }
}
