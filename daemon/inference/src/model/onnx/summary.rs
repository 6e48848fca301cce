//! Description of a model on disk, without loading it.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use peernet_external::sha256;
use serde::Serialize;

use super::card::Card;
use super::model_files::model_files;
use super::{CARD, MODEL, regular_file};
use crate::LoadError;

/// Card of a model as text.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CardSummary {
    /// Name of the model, which may differ from the name of its folder.
    pub name: String,
    /// Version; may be empty.
    pub version: String,
    /// Task: `classification`, `detection`, `segmentation`, `embedding` or `tensors`.
    pub task: String,
    /// Description; may be empty.
    pub description: String,
    /// Shape, element type and order of dimensions of the input: `1 × 3 × 384 × 384 float32 nchw`. If there are several
    /// inputs, each description begins with the input's name.
    pub input: String,
    /// Colours, resize, crop and normalisation, in the order in which they are applied.
    pub preprocessing: Vec<String>,
    /// Description of the answer: for a classification, the number of classes, the activation function and the number
    /// of listed classes.
    pub output: String,
    /// The classes, in the order of the output; empty if the task has none.
    pub labels: Vec<String>,
    /// Origin of the model, as pairs.
    pub provenance: Vec<(String, String)>,
}

/// Returns the summary of the card in a model's folder.
///
/// # Errors
/// If the card is invalid, or if an ONNX file is missing or invalid.
pub(crate) fn summarise(folder: &Path) -> Result<CardSummary, LoadError> {
    let card = Card::read(&folder.join(CARD))?;
    for file in model_files(folder)? {
        open(&file)?;
    }
    Ok(card.summary())
}

/// Returns the SHA-256 of the ONNX files in a model's folder, in hexadecimal. The hashed bytes are those of
/// `model.onnx`, followed by those of its data files in the order of the files' names.
///
/// # Errors
/// If a file is missing or cannot be read, or if `model.onnx` is not an ONNX model.
pub(crate) fn hash_model(folder: &Path) -> Result<String, LoadError> {
    let mut contents: Box<dyn Read> = Box::new(io::empty());
    for file in model_files(folder)? {
        contents = Box::new(contents.chain(open(&file)?));
    }
    let error = |error: io::Error| LoadError::File { file: folder.join(MODEL), reason: error.to_string() };
    sha256(contents).map_err(error)
}

/// Returns the SHA-256 of the card in a model's folder, in hexadecimal.
///
/// # Errors
/// If the card cannot be read.
pub(crate) fn hash_card(folder: &Path) -> Result<String, LoadError> {
    let file = folder.join(CARD);
    let hash = regular_file::open(&file).and_then(sha256);
    hash.map_err(|error| LoadError::File { file, reason: error.to_string() })
}

fn open(file: &Path) -> Result<File, LoadError> {
    regular_file::open(file)
        .map_err(|error| LoadError::File { file: file.to_owned(), reason: error.to_string() })
}

#[cfg(test)]
mod tests {
    use rustix::fs::{CWD, FileType, Mode, mknodat};

    use super::super::card::tests::SMALL;
    use super::*;

    /// A model with an empty graph.
    const SMALLEST: &[u8] = b"\x3a\x00";

    #[test]
    fn named_pipe_or_empty_file_as_model_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join(CARD), SMALL).expect("written");
        let model = folder.path().join(MODEL);
        mknodat(CWD, &model, FileType::Fifo, Mode::RUSR, 0).expect("a pipe");
        for error in [summarise(folder.path()).map(drop), hash_model(folder.path()).map(drop)] {
            let error = error.expect_err("refused").to_string();
            assert!(error.contains("model.onnx") && error.contains("not a regular file"), "{error}");
        }
        std::fs::remove_file(&model).expect("removed");
        std::fs::write(&model, []).expect("written");
        let error = hash_model(folder.path()).expect_err("refused").to_string();
        assert!(error.contains("model.onnx") && error.contains("it is empty"), "{error}");
        std::fs::write(&model, SMALLEST).expect("written");
        assert!(summarise(folder.path()).is_ok());
    }

    #[test]
    fn card_hash_equals_output_of_sha256sum() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join(CARD), "abc").expect("written");
        // Example in FIPS 180-4.
        let known = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(hash_card(folder.path()).expect("is read"), known);
    }

    #[test]
    fn hash_changes_with_weights_in_another_file() {
        let folder = tempfile::tempdir().expect("a folder");
        // A graph with a tensor whose entry `location` is `w`.
        let model = b"\x3a\x11\x2a\x0f\x6a\x0d\x0a\x08location\x12\x01w";
        std::fs::write(folder.path().join(MODEL), model).expect("written");
        let missing = hash_model(folder.path()).expect_err("no file w").to_string();
        assert!(missing.contains("/w"), "{missing}");
        let hash = |weights: &str| {
            std::fs::write(folder.path().join("w"), weights).expect("written");
            hash_model(folder.path()).expect("is read")
        };
        assert_eq!(hash("1"), sha256([&model[..], &b"1"[..]].concat().as_slice()).expect("is read"));
        assert_ne!(hash("1"), hash("0"));
    }
}
