//! Folders in which models are searched.

use std::collections::HashSet;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use peernet_logger::Slug;
use peernet_sample::Sample;

use super::BankConfig;
use crate::model::onnx::{self, CardSummary};
use crate::{LoadError, ModelConfig};

/// Folder of models in which the agent of the package and `peernet models` search by default.
pub const DEFAULT_MODEL_FOLDER: &str = "/var/lib/peernet/models";

/// Environment variable with further folders, separated by colons.
const FOLDERS_VARIABLE: &str = "PEERNET_MODELS";

/// Folders that hold one folder per model, in the order in which they are searched.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelFolders(Vec<PathBuf>);

/// A model on disk.
#[derive(Debug)]
pub struct ModelOnDisk {
    /// Name of the model: the name of its folder.
    pub name: Slug,
    /// The folder with `model.onnx` and its card `model.toml`.
    pub folder: PathBuf,
    /// Summary of the card, or an error of the model that is found without loading the model.
    pub card: Result<CardSummary, LoadError>,
    /// Folder of another model with the same name. The other model takes precedence, because its folder is searched
    /// first.
    pub shadowed_by: Option<PathBuf>,
}

impl ModelFolders {
    /// Returns the folders that the command line searches: `extra`, then the folders of `PEERNET_MODELS`,
    /// [`DEFAULT_MODEL_FOLDER`] and `models` in the working directory.
    pub fn search(extra: &[PathBuf]) -> Self {
        let variable = std::env::var_os(FOLDERS_VARIABLE).unwrap_or_default();
        let of_variable = std::env::split_paths(&variable).filter(|path| !path.as_os_str().is_empty());
        Self::new(
            extra.iter().cloned().chain(of_variable).chain([DEFAULT_MODEL_FOLDER.into(), "models".into()]),
        )
    }

    /// Creates the list of these folders. A folder that occurs a second time, perhaps under another path, is left out.
    pub fn new(folders: impl IntoIterator<Item = PathBuf>) -> Self {
        let mut seen = HashSet::new();
        let is_new = |folder: &PathBuf| seen.insert(folder.canonicalize().unwrap_or_else(|_| folder.clone()));
        Self(folders.into_iter().filter(is_new).collect())
    }

    /// Returns the folders in the order in which they are searched; some of them need not exist.
    pub fn paths(&self) -> &[PathBuf] {
        &self.0
    }

    /// Lists all models, folder by folder, and in each folder by name. A folder that does not exist contains no models.
    pub fn list(&self) -> Vec<ModelOnDisk> {
        let mut models: Vec<ModelOnDisk> = Vec::new();
        for parent in &self.0 {
            let mut names = model_names(parent).unwrap_or_default();
            names.sort();
            for name in names {
                let preferred = models.iter().find(|model| model.name == name && model.shadowed_by.is_none());
                let shadowed_by = preferred.map(|model| model.folder.clone());
                models.push(ModelOnDisk {
                    shadowed_by,
                    ..ModelOnDisk::read(name.clone(), parent.join(name.as_str()))
                });
            }
        }
        models
    }

    /// Finds the model of this name. A name with a slash is the path of the model's folder.
    ///
    /// # Errors
    /// If there is no such model. A model with an error is found, too; the error is in the field `card`.
    pub fn find(&self, name: &str) -> Result<ModelOnDisk, LoadError> {
        if name.contains('/') {
            return ModelOnDisk::in_folder(Path::new(name));
        }
        let slug: Option<Slug> = name.parse().ok();
        let mut candidates =
            self.0.iter().filter_map(|parent| Some((slug.clone()?, parent.join(slug.as_ref()?.as_str()))));
        if let Some((name, folder)) = candidates.find(|(_, folder)| is_model(folder)) {
            return Ok(ModelOnDisk::read(name, folder));
        }
        let names = self.0.iter().flat_map(|parent| model_names(parent).unwrap_or_default());
        let mut known: Vec<String> = names.map(|name| name.to_string()).collect();
        known.sort();
        let mut seen = HashSet::new();
        known.retain(|name| seen.insert(name.clone()));
        Err(LoadError::NotFound { name: name.to_owned(), searched: self.0.clone(), known })
    }

    /// Returns an error for each folder that exists and cannot be read.
    pub fn check(&self) -> Vec<LoadError> {
        let unreadable = |parent: &PathBuf| match model_names(parent) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                Some(LoadError::File { file: parent.clone(), reason: error.to_string() })
            }
            _ => None,
        };
        self.0.iter().filter_map(unreadable).collect()
    }
}

impl ModelOnDisk {
    fn read(name: Slug, folder: PathBuf) -> Self {
        let card = onnx::summarise(&folder);
        Self { name, folder, card, shadowed_by: None }
    }

    fn in_folder(folder: &Path) -> Result<Self, LoadError> {
        let file_error = |reason: String| LoadError::File { file: folder.to_owned(), reason };
        // A path such as `./` does not end with the name of a folder.
        let folder = folder.canonicalize().map_err(|error| file_error(error.to_string()))?;
        if !is_model(&folder) {
            return Err(file_error("the folder contains neither model.onnx nor model.toml".to_owned()));
        }
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        let name =
            name.parse().map_err(|error: peernet_logger::InvalidName| file_error(error.to_string()))?;
        Ok(Self::read(name, folder))
    }

    /// Returns the configuration of this model on `device`, with one worker and with the defaults of all other keys of
    /// `[[model]]`.
    pub fn configuration(&self, device: &str) -> ModelConfig {
        BankConfig::default().model(&self.name, &self.folder, device)
    }

    /// Returns a sample that the model accepts: pictures of generated pixels, 1280 × 720 if the model resizes them,
    /// and arrays of zeros.
    ///
    /// # Errors
    /// If the card is invalid.
    pub fn example_sample(&self) -> Result<Sample, LoadError> {
        onnx::example_sample(&self.folder)
    }

    /// Computes the SHA-256 of `model.onnx` and the data files of its weights, in hexadecimal.
    ///
    /// # Errors
    /// If a file cannot be read.
    pub fn hash(&self) -> Result<String, LoadError> {
        onnx::hash_model(&self.folder)
    }

    /// Returns the total size of `model.onnx` and the data files of its weights, bytes; `None` if a file is missing
    /// or `model.onnx` is not a model.
    pub fn size(&self) -> Option<u64> {
        onnx::model_files(&self.folder).ok()?.iter().map(|file| Some(file.metadata().ok()?.len())).sum()
    }
}

fn is_model(folder: &Path) -> bool {
    [onnx::MODEL, onnx::CARD].iter().any(|file| folder.join(file).exists())
}

/// Reads the names of the models in a folder.
fn model_names(parent: &Path) -> std::io::Result<Vec<Slug>> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(parent)? {
        let entry = entry?;
        // A folder whose name is not a slug is skipped.
        if let Some(Ok(name)) = entry.file_name().to_str().map(str::parse)
            && is_model(&entry.path())
        {
            names.push(name);
        }
    }
    Ok(names)
}
