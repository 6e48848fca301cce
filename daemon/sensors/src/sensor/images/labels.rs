//! Labels of a folder of pictures: the expected answers.

use std::collections::HashMap;
use std::io;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::folder::is_file;
use crate::SensorError;

/// Name of the file of labels in a folder of pictures: comma-separated, with the columns `file` and `label`.
pub(super) const LABELS_FILE: &str = "labels.csv";

/// Labels by the path of the picture below the folder.
pub(super) type Labels = HashMap<String, String>;

#[derive(Deserialize)]
struct Row {
    file: String,
    label: String,
}

/// Reads the labels of `folder`, from the `given` file or from the file in the folder, and returns them with the path
/// of that file. Returns `None` if no file is given and the folder has none. A row without a label is ignored.
///
/// # Errors
/// If the file cannot be used or contains no label, or if the given file does not exist.
pub(super) fn read(folder: &Path, given: Option<&Path>) -> Result<Option<(Labels, PathBuf)>, SensorError> {
    let file = given.map_or_else(|| folder.join(LABELS_FILE), Path::to_owned);
    if given.is_none() && file.exists() && !is_file(&file) {
        return Err(SensorError::Read { path: file, error: io::Error::other("it is not a regular file") });
    }
    let text = match std::fs::read_to_string(&file) {
        Ok(text) => text,
        Err(error) if given.is_none() && error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(SensorError::Read { path: file, error }),
    };
    let invalid = |reason: String| SensorError::Labels { file: file.clone(), reason };
    let mut labels = Labels::new();
    for row in csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes()).deserialize() {
        let Row { file, label } = row.map_err(|error| {
            invalid(format!("{error}; expected a first line `file,label` and one line per picture"))
        })?;
        if label.is_empty() {
            continue;
        }
        if let Some(other) = labels.insert(file.clone(), label.clone())
            && other != label
        {
            return Err(invalid(format!("{file} is labelled both {other} and {label}")));
        }
    }
    if labels.is_empty() {
        return Err(invalid(
            "it contains no label, so that no answer can be scored; write a first line `file,label` and one line per picture, or remove the file".to_owned(),
        ));
    }
    Ok(Some((labels, file)))
}
