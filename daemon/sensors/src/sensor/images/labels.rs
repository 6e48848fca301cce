//! Labels of the pictures in a folder: the expected answers.

use std::collections::HashMap;
use std::io;
use std::path::{Path, PathBuf};

use peernet_sample::LabelledObject;
use serde::Deserialize;

use super::folder::is_file;
use crate::SensorError;

/// Name of the file with labels in a folder of pictures. It is comma-separated and has the columns `file` and `label`,
/// and for boxes of objects also `left`, `top`, `right` and `bottom`; or it has the columns `file` and `mask`.
pub(super) const LABELS_FILE: &str = "labels.csv";

/// Defect of a file without any label.
const NO_LABEL: &str = "it contains no label, so no answer can be scored; write a first line `file,label` and one line per picture, or \
     remove the file";

/// Expected answer to a picture.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Label {
    /// A class.
    Class(String),
    /// Objects in the picture, with their boxes in pixels of the file; may be empty.
    Objects(Vec<LabelledObject>),
    /// Path of the mask, a picture whose pixel values are class numbers.
    Mask(String),
}

/// Labels of pictures. The key is the path of the picture below the folder.
pub(super) type Labels = HashMap<String, Label>;

/// Row of a file with classes, or with boxes of objects.
#[derive(Deserialize)]
struct LabelRow {
    file: String,
    label: String,
    #[serde(default)]
    left: Option<f32>,
    #[serde(default)]
    top: Option<f32>,
    #[serde(default)]
    right: Option<f32>,
    #[serde(default)]
    bottom: Option<f32>,
}

/// Row of a file with masks.
#[derive(Deserialize)]
struct MaskRow {
    file: String,
    /// Path of the mask below the folder of the pictures.
    mask: String,
}

/// Returns the labels of a file with masks. A row without a mask is ignored.
fn read_masks<R: io::Read>(folder: &Path, mut reader: csv::Reader<R>) -> Result<Labels, String> {
    let mut labels = Labels::new();
    for row in reader.deserialize() {
        let MaskRow { file, mask } = row.map_err(|error: csv::Error| {
            format!("{error}; expected a first line `file,mask` and one line per picture")
        })?;
        if mask.is_empty() {
            continue;
        }
        let path = folder.join(&mask);
        if !is_file(&path) {
            return Err(format!("the mask {} of {file} is no file", path.display()));
        }
        let path = path.into_os_string().into_string();
        let path = path.map_err(|path| format!("the name of the mask {} is not UTF-8", path.display()))?;
        if labels.insert(file.clone(), Label::Mask(path)).is_some() {
            return Err(format!("{file} has several masks"));
        }
    }
    Ok(labels)
}

impl LabelRow {
    /// Returns the object that the row describes; `None` if the row has no label, which means that the picture has no
    /// objects.
    fn object(self) -> Result<Option<LabelledObject>, String> {
        let Self { file, label, left, top, right, bottom } = self;
        if label.is_empty() {
            return Ok(None);
        }
        let edges = left.zip(top).zip(right.zip(bottom));
        let edges = edges.map(|((left, top), (right, bottom))| [left, top, right, bottom]);
        let object = edges.map(|edges| LabelledObject { label: label.clone(), edges });
        match object.filter(LabelledObject::is_valid) {
            Some(object) => Ok(Some(object)),
            None => Err(format!(
                "the box of {label} in {file} is incomplete; write left, top, right and bottom in pixels, with left < right and \
                 top < bottom"
            )),
        }
    }
}

/// Reads the labels of the pictures in `folder` from `configured_file`, or else from [`LABELS_FILE`] in the folder.
/// Returns the labels with the path of the file; `None` if no file is configured and the folder has none. A row without
/// a label is ignored; in a file with boxes it means that the picture has no objects.
///
/// # Errors
/// If the file cannot be used or contains no label, or if the configured file does not exist.
pub(super) fn read(
    folder: &Path,
    configured_file: Option<&Path>,
) -> Result<Option<(Labels, PathBuf)>, SensorError> {
    let file = configured_file.map_or_else(|| folder.join(LABELS_FILE), Path::to_owned);
    // A file that is not configured must not block the start, as reading from a named pipe would. A configured file may
    // be a pipe.
    if configured_file.is_none() && file.exists() && !is_file(&file) {
        return Err(SensorError::Read { path: file, error: io::Error::other("it is not a regular file") });
    }
    let text = match std::fs::read_to_string(&file) {
        Ok(text) => text,
        Err(error) if configured_file.is_none() && error.kind() == std::io::ErrorKind::NotFound => {
            return Ok(None);
        }
        Err(error) => return Err(SensorError::Read { path: file, error }),
    };
    let invalid = |reason: String| SensorError::Labels { file: file.clone(), reason };
    let mut labels = Labels::new();
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes());
    if reader.headers().is_ok_and(|columns| columns.iter().any(|column| column == "mask")) {
        let labels = read_masks(folder, reader).map_err(&invalid)?;
        return if labels.is_empty() { Err(invalid(NO_LABEL.to_owned())) } else { Ok(Some((labels, file))) };
    }
    let has_boxes = reader.headers().is_ok_and(|columns| columns.iter().any(|column| column == "left"));
    for row in reader.deserialize() {
        let row: LabelRow = row.map_err(|error| {
            invalid(format!("{error}; expected a first line `file,label` and one line per picture"))
        })?;
        if has_boxes {
            let file = row.file.clone();
            let entry = labels.entry(file).or_insert_with(|| Label::Objects(Vec::new()));
            if let (Label::Objects(objects), Some(object)) = (entry, row.object().map_err(invalid)?) {
                objects.push(object);
            }
            continue;
        }
        let LabelRow { file, label, .. } = row;
        if label.is_empty() {
            continue;
        }
        if let Some(Label::Class(other)) = labels.insert(file.clone(), Label::Class(label.clone()))
            && other != label
        {
            return Err(invalid(format!("{file} is labelled both {other} and {label}")));
        }
    }
    if labels.is_empty() {
        return Err(invalid(NO_LABEL.to_owned()));
    }
    Ok(Some((labels, file)))
}
