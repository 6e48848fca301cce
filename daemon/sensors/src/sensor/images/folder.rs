//! Search for the pictures in a folder.

use std::fs;
use std::path::{Path, PathBuf};

use peernet_sample::MediaType;

use crate::SensorError;

/// Returns the media type of a picture file by the extension of its name; `None` for other extensions.
pub(super) fn media_type(file: &Path) -> Option<MediaType> {
    let extension = file.extension()?.to_str()?.to_ascii_lowercase();
    match extension.as_str() {
        "jpg" | "jpeg" => Some(MediaType::Jpeg),
        "png" => Some(MediaType::Png),
        _ => None,
    }
}

/// Returns whether the path is a regular file or a link to a regular file. Reading from anything else may block for
/// ever.
pub(super) fn is_file(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|metadata| metadata.is_file())
}

/// Returns all pictures in `folder` and the folders below it, sorted by path. Hidden files and folders are left out.
/// Links to folders are not followed, because they may form a cycle.
pub(super) fn pictures(folder: &Path) -> Result<Vec<PathBuf>, SensorError> {
    let mut found = Vec::new();
    let mut pending = vec![folder.to_owned()];
    while let Some(folder) = pending.pop() {
        let read_error = |error| SensorError::Read { path: folder.clone(), error };
        for entry in fs::read_dir(&folder).map_err(read_error)? {
            let entry = entry.map_err(read_error)?;
            let path = entry.path();
            if entry.file_name().as_encoded_bytes().starts_with(b".") {
                continue;
            }
            let kind = entry.file_type().map_err(|error| SensorError::Read { path: path.clone(), error })?;
            if kind.is_dir() {
                pending.push(path);
            } else if media_type(&path).is_some() && (kind.is_file() || is_file(&path)) {
                found.push(path);
            }
        }
    }
    // `read_dir` has no defined order, but every run must see the pictures in the same order.
    found.sort_unstable();
    Ok(found)
}
