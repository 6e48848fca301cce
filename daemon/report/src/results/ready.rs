//! Finding folders of results and making them ready.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::folder::{DATA, RECORD, SUMMARIES};
use super::{FolderError, Overwrite};

/// Figures of a run, which would show what is there no longer.
const FIGURES: [&str; 6] = [
    "sensing-time",
    "upload-time",
    "inference-time",
    "download-time",
    "upload-throughput",
    "download-throughput",
];
/// How deep below a folder results are looked for.
const DEEPEST: usize = 8;

pub(super) fn create(dir: &Path, overwrite: Overwrite) -> Result<PathBuf, FolderError> {
    let failed = |path: &Path, error: &std::io::Error| FolderError::Make {
        path: path.to_owned(),
        reason: error.to_string(),
    };
    let empty = match std::fs::read_dir(dir) {
        Ok(mut entries) => entries.next().is_none(),
        Err(error) if error.kind() == ErrorKind::NotFound => true,
        Err(error) if error.kind() == ErrorKind::NotADirectory => {
            return Err(FolderError::NoFolder(dir.to_owned()));
        }
        Err(error) => return Err(failed(dir, &error)),
    };
    match overwrite {
        _ if empty => {}
        Overwrite::Refuse => return Err(FolderError::NotEmpty(dir.to_owned())),
        Overwrite::Replace => clear(dir)?,
        Overwrite::Subfolder => return subfolder(dir).map_err(|error| failed(dir, &error)),
    }
    std::fs::create_dir_all(dir).map_err(|error| failed(dir, &error))?;
    Ok(dir.to_owned())
}

/// Takes away what an earlier run left.
fn clear(dir: &Path) -> Result<(), FolderError> {
    let figures = FIGURES.iter().flat_map(|stem| ["png", "svg"].map(|kind| format!("{stem}.{kind}")));
    let ours = [DATA, RECORD].into_iter().chain(SUMMARIES).map(str::to_owned).chain(figures);
    for path in ours.map(|name| dir.join(name)) {
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                return Err(crate::WriteError::at(&path)(error).into());
            }
            _ => {}
        }
    }
    Ok(())
}

/// The first that is not there, made at once: two programs never get the same.
fn subfolder(dir: &Path) -> std::io::Result<PathBuf> {
    let mut number = 2_u32;
    loop {
        let path = dir.join(format!("run-{number}"));
        match std::fs::create_dir(&path) {
            Ok(()) => return Ok(path),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => number += 1,
            Err(error) => return Err(error),
        }
    }
}

pub(super) fn find(dir: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    look(dir, DEEPEST, &mut found);
    found
}

fn look(dir: &Path, levels: usize, found: &mut Vec<PathBuf>) {
    if dir.join(DATA).is_file() {
        found.push(dir.to_owned());
    }
    let Some(levels) = levels.checked_sub(1) else { return };
    // A folder that cannot be looked into holds nothing that could be read.
    let entries = std::fs::read_dir(dir).into_iter().flatten().filter_map(Result::ok);
    let mut folders: Vec<PathBuf> = entries
        .filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir()))
        .map(|entry| entry.path())
        .collect();
    folders.sort_by_cached_key(|path| natural(&path.file_name().unwrap_or_default().to_string_lossy()));
    folders.iter().for_each(|folder| look(folder, levels, found));
}

/// A key by which `run-2` stands before `run-10`: text and the numbers in it by turns.
fn natural(name: &str) -> Vec<(String, u128)> {
    let mut key = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let digits = rest.find(|char: char| char.is_ascii_digit()).unwrap_or(rest.len());
        let (text, tail) = rest.split_at(digits);
        let end = tail.find(|char: char| !char.is_ascii_digit()).unwrap_or(tail.len());
        let (number, tail) = tail.split_at(end);
        key.push((text.to_owned(), number.parse().unwrap_or(u128::MAX)));
        rest = tail;
    }
    key
}
