//! Description of a model on disk, without loading it.

use std::path::Path;

use peernet_external::sha256;
use serde::Serialize;

use super::card::{Activation, Card, CentreCrop, Resize, Rounding};
use super::{CARD, MODEL, regular_file};
use crate::LoadError;

/// Card of a model as text.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CardSummary {
    /// Name of the model, which may differ from that of its folder.
    pub name: String,
    /// Version; may be empty.
    pub version: String,
    /// Task: `classification`.
    pub task: String,
    /// Description; may be empty.
    pub description: String,
    /// Shape, element type and order of dimensions: `1 × 3 × 384 × 384 float32 nchw`.
    pub input: String,
    /// Colours, resize, crop and normalisation, in the order in which they are applied.
    pub preprocessing: Vec<String>,
    /// Number of classes, scoring, and number of listed classes.
    pub output: String,
    /// The classes, in the order of the output.
    pub labels: Vec<String>,
    /// Origin of the model, as pairs.
    pub provenance: Vec<(String, String)>,
}

/// Returns the card of the model in a folder.
///
/// # Errors
/// If the card is invalid, or `model.onnx` is missing.
pub(crate) fn summarise(folder: &Path) -> Result<CardSummary, LoadError> {
    let card = Card::read(&folder.join(CARD))?;
    let file = folder.join(MODEL);
    match regular_file::open(&file) {
        Ok(_) => Ok(card.summary()),
        Err(error) => Err(LoadError::File { file, reason: error.to_string() }),
    }
}

/// Returns the SHA-256 of a file in a model's folder, in hexadecimal.
///
/// # Errors
/// If the file cannot be read.
pub(crate) fn hash(folder: &Path, file: &str) -> Result<String, LoadError> {
    let file = folder.join(file);
    let hash = regular_file::open(&file).and_then(sha256);
    hash.map_err(|error| LoadError::File { file, reason: error.to_string() })
}

impl Card {
    /// Returns the card as text.
    pub(super) fn summary(&self) -> CardSummary {
        let Self { input, preprocessing, output, .. } = self;
        let shape: Vec<_> = input.shape.iter().map(usize::to_string).collect();
        let colour = format!("{:?}", input.colour).to_lowercase();
        let mut steps = vec![format!("colours {colour}")];
        steps.extend(preprocessing.resize.map(describe_resize));
        steps.extend(preprocessing.crop.map(describe_crop));
        let (scale, mean, std) = (preprocessing.scale, &preprocessing.mean, &preprocessing.std);
        steps.push(format!("(byte × {scale} − mean) / std, mean {mean:?}, std {std:?}"));
        let scores = match output.activation {
            Activation::None => "scores as they come",
            Activation::Softmax => "softmax",
            Activation::Sigmoid => "sigmoid",
        };
        CardSummary {
            name: self.name.clone(),
            version: self.version.clone(),
            task: format!("{:?}", self.task).to_lowercase(),
            description: self.description.clone(),
            input: format!("{} float32 {}", shape.join(" × "), input.layout),
            preprocessing: steps,
            output: format!("{} classes, {scores}, best {} listed", output.labels.len(), output.top_k),
            labels: output.labels.clone(),
            provenance: self.provenance.iter().map(|(key, value)| (key.clone(), plain_text(value))).collect(),
        }
    }
}

fn describe_resize(resize: Resize) -> String {
    let (what, filter, antialias) = match resize {
        Resize::Exact { width, height, filter, antialias } => {
            (format!("to {width} × {height}"), filter, antialias)
        }
        Resize::Shortest { size, filter, antialias } => {
            (format!("shorter side to {size}"), filter, antialias)
        }
    };
    let how = if antialias { "antialiased" } else { "not antialiased" };
    format!("resize {what}, {}, {how}", format!("{filter:?}").to_lowercase())
}

fn describe_crop(CentreCrop { width, height, rounding }: CentreCrop) -> String {
    let rounding = match rounding {
        Rounding::Down => "",
        Rounding::HalfEven => ", odd margins split half to even",
    };
    format!("centre crop {width} × {height}{rounding}")
}

/// Returns a value as text; a string without its quotes.
fn plain_text(value: &toml::Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

#[cfg(test)]
mod tests {
    use rustix::fs::{CWD, FileType, Mode, mknodat};

    use super::super::card::tests::{SMALL, changed};
    use super::*;

    #[test]
    fn plan_describes_every_step() {
        let card = changed(
            "resize = { mode = \"exact\", width = 2, height = 1 }",
            "resize = { mode = \"shortest\", size = 3, filter = \"bicubic\" }\n\
             crop = { width = 2, height = 1, rounding = \"half-even\" }",
        );
        let summary = card.expect("is right").summary();
        assert_eq!(summary.input, "1 × 1 × 1 × 2 float32 nchw");
        assert_eq!(
            summary.preprocessing,
            [
                "colours grey",
                "resize shorter side to 3, bicubic, antialiased",
                "centre crop 2 × 1, odd margins split half to even",
                "(byte × 0.5 − mean) / std, mean [1.0], std [2.0]",
            ]
        );
        assert_eq!(summary.output, "2 classes, softmax, best 5 listed");
    }

    #[test]
    fn named_pipe_as_model_file_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join(CARD), SMALL).expect("written");
        let model = folder.path().join(MODEL);
        mknodat(CWD, &model, FileType::Fifo, Mode::RUSR, 0).expect("a pipe");
        for error in [summarise(folder.path()).map(drop), hash(folder.path(), MODEL).map(drop)] {
            let error = error.expect_err("refused").to_string();
            assert!(error.contains("model.onnx") && error.contains("not a regular file"), "{error}");
        }
        std::fs::remove_file(&model).expect("removed");
        std::fs::write(&model, "abc").expect("written");
        assert!(summarise(folder.path()).is_ok());
    }

    #[test]
    fn hash_is_that_of_sha256sum() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join(MODEL), "abc").expect("written");
        // Example in FIPS 180-4.
        let expected_hash = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(hash(folder.path(), MODEL).expect("is read"), expected_hash);
    }
}
