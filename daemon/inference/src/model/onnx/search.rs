//! Search for ONNX Runtime's library.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use crate::LibraryError;

/// Settings on which the search depends.
#[derive(Clone, Debug, Default)]
pub(super) struct SearchSettings {
    /// The key `library` of `[onnxruntime]`.
    pub(super) configured: Option<PathBuf>,
    /// The variable `ORT_DYLIB_PATH`.
    pub(super) variable: Option<OsString>,
    /// The current directory.
    pub(super) current: PathBuf,
    /// The file of this program.
    pub(super) executable: PathBuf,
}

/// Library file that was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Candidate {
    /// The file, with links resolved.
    pub(super) path: PathBuf,
    /// Step of the search that found the file.
    pub(super) origin: &'static str,
}

/// Path of the library's folder, relative to each folder that is searched.
const LIBRARY_FOLDER: &str = "onnxruntime/lib";
/// Folder in which the package installs the library.
const INSTALL_FOLDER: &str = "/usr/lib/peernet";
/// Names of the library's file; the first one is preferred.
const NAMES: [&str; 2] = ["libonnxruntime.so", "libonnxruntime.so.1"];

impl SearchSettings {
    pub(super) fn from_environment(configured: Option<&Path>) -> Self {
        Self {
            configured: configured.map(Path::to_owned),
            variable: std::env::var_os("ORT_DYLIB_PATH").filter(|value| !value.is_empty()),
            current: std::env::current_dir().unwrap_or_default(),
            executable: std::env::current_exe().unwrap_or_default(),
        }
    }

    /// Returns the first library that the search finds, and the paths that were searched before. The last step, the
    /// system's library path, is left to the system's loader: the first value is then `None`.
    ///
    /// A library that the configuration or the variable names is never replaced by another one: if it cannot be used,
    /// the search fails.
    pub(super) fn search(&self) -> Result<(Option<Candidate>, Vec<String>), LibraryError> {
        let mut searched = Vec::new();
        let variable = self.variable.as_ref().map(PathBuf::from);
        let explicit =
            [("[onnxruntime] library", self.configured.as_ref()), ("ORT_DYLIB_PATH", variable.as_ref())];
        for (origin, path) in explicit {
            let Some(path) = path else {
                searched.push(format!("{origin}: not set"));
                continue;
            };
            let library = self.current.join(path);
            return match library_at(&library) {
                Some(path) => Ok((Some(Candidate { path, origin }), searched)),
                None if library.is_dir() => {
                    let reason = format!("the folder contains no {}", NAMES.join(" or "));
                    Err(LibraryError::Unusable { library, origin, reason })
                }
                None => Err(LibraryError::Unusable {
                    library,
                    origin,
                    reason: "the file does not exist".to_owned(),
                }),
            };
        }
        for folder in self.folders() {
            if let Some(path) = library_at(&folder) {
                return Ok((Some(Candidate { path, origin: "found in a folder" }), searched));
            }
            searched.push(format!("{}: none", folder.display()));
        }
        Ok((None, searched))
    }

    /// Returns the folders to search: one below the current directory, one below the program's folder and below each
    /// folder above that folder, and the folder in which the package installs the library.
    fn folders(&self) -> Vec<PathBuf> {
        let mut folders = vec![self.current.join(LIBRARY_FOLDER)];
        folders.extend(self.executable.ancestors().skip(1).map(|ancestor| ancestor.join(LIBRARY_FOLDER)));
        folders.push(INSTALL_FOLDER.into());
        let mut seen = std::collections::HashSet::new();
        folders.retain(|folder| seen.insert(folder.clone()));
        folders
    }
}

/// Returns the library at a path: the file itself, or a file in the folder with one of the library's names.
fn library_at(path: &Path) -> Option<PathBuf> {
    let resolved = |path: &Path| path.canonicalize().ok().filter(|path| path.is_file());
    resolved(path).or_else(|| NAMES.iter().find_map(|name| resolved(&path.join(name))))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn create_file(folder: &Path, name: &str) -> PathBuf {
        fs::create_dir_all(folder).expect("can be made");
        fs::write(folder.join(name), "").expect("can be written");
        folder.join(name).canonicalize().expect("exists")
    }

    fn found(search_settings: &SearchSettings) -> Option<PathBuf> {
        search_settings.search().expect("no explicit path is wrong").0.map(|candidate| candidate.path)
    }

    #[test]
    fn search_order_is_configuration_variable_folders() {
        let root = tempfile::tempdir().expect("can be made");
        let at = |path: &str| root.path().join(path);
        let mut search_settings = SearchSettings {
            current: at("current"),
            executable: at("tree/target/debug/program"),
            ..Default::default()
        };
        assert_eq!(found(&search_settings), None);

        let above = create_file(&at("tree/onnxruntime/lib"), "libonnxruntime.so.1");
        assert_eq!(found(&search_settings), Some(above));
        let current = create_file(&at("current/onnxruntime/lib"), "libonnxruntime.so");
        assert_eq!(found(&search_settings), Some(current));
        let variable = create_file(&at("own"), "mine.so");
        search_settings.variable = Some(variable.clone().into());
        assert_eq!(found(&search_settings), Some(variable));
        let configured = create_file(&at("current/built"), "libonnxruntime.so");
        search_settings.configured = Some("built".into());
        assert_eq!(found(&search_settings), Some(configured));
    }

    #[test]
    fn missing_configured_library_has_no_fallback() {
        let root = tempfile::tempdir().expect("can be made");
        create_file(&root.path().join(LIBRARY_FOLDER), "libonnxruntime.so");
        let mut search_settings = SearchSettings { current: root.path().to_owned(), ..Default::default() };
        search_settings.variable = Some("nowhere.so".into());
        let error = search_settings.search().expect_err("the variable names a missing file").to_string();
        assert!(error.contains("nowhere.so (ORT_DYLIB_PATH)") && error.contains("make setup"), "{error}");
        search_settings.configured = Some(root.path().to_owned());
        let error = search_settings.search().expect_err("the folder contains no library").to_string();
        assert!(error.contains("contains no libonnxruntime.so"), "{error}");
    }

    #[test]
    fn search_error_lists_all_places() {
        let search_settings = SearchSettings {
            current: "/nowhere/current".into(),
            executable: "/nowhere/bin/program".into(),
            ..Default::default()
        };
        let (_, searched) = search_settings.search().expect("no path is explicit");
        for place in [
            "[onnxruntime] library",
            "ORT_DYLIB_PATH",
            "/nowhere/current/onnxruntime/lib",
            "/nowhere/bin/onnxruntime/lib",
            INSTALL_FOLDER,
        ] {
            assert!(searched.iter().any(|line| line.starts_with(place)), "{place}: {searched:?}");
        }
        let error = LibraryError::NotFound { searched }.to_string();
        assert!(error.contains(INSTALL_FOLDER) && error.contains("make setup"), "{error}");
    }
}
