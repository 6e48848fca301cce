//! Description of a custom object: interpreter, files, libraries.

use std::path::PathBuf;

use peernet_sample::printable_lines;
use serde::Deserialize;

use crate::digest;

/// Description of an object, as its process reports it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
pub struct ObjectDescription {
    /// Version of Python, such as `3.11.2`.
    pub python: String,
    /// Path of the interpreter.
    executable: String,
    /// Description of the object, such as `class camera::Camera`.
    #[serde(rename = "what")]
    pub object: String,
    /// Files of the object's own code, without files of libraries; the file of its module is the first.
    files: Vec<PathBuf>,
    /// Names and versions of the libraries that `files` import anywhere, and of the libraries that were imported
    /// during the start. A version may be empty.
    libraries: Vec<(String, String)>,
    /// `true` if `files` or `libraries` is incomplete because of its limit.
    #[serde(rename = "more")]
    is_incomplete: bool,
    /// `true` if a sensor or an actuator has `reset()`.
    resets: bool,
    /// `true` if a sensor has `advance(seconds)`.
    advances: bool,
}

impl ObjectDescription {
    /// Returns whether the object is a sensor or an actuator with `reset()`.
    pub(super) const fn resets(&self) -> bool {
        self.resets
    }

    /// Returns whether the object is a sensor with `advance(seconds)`.
    pub(super) const fn advances(&self) -> bool {
        self.advances
    }

    /// Returns facts for the run's page, such as (`Sensor`, `the Python class camera::Camera, Python 3.11.2`). The
    /// name of each fact begins with `role`. Reads the files for their hashes.
    pub fn facts(&self, role: &str) -> Vec<(String, String)> {
        let mut facts =
            vec![(role.to_owned(), format!("the Python {}, Python {}", self.object, self.python))];
        if !self.executable.is_empty() {
            facts.push((format!("{role} interpreter"), printable_lines(&self.executable).into_owned()));
        }
        facts.extend(digest::files_fact(role, &self.files));
        if !self.libraries.is_empty() {
            let library = |(name, version): &(String, String)| match version.as_str() {
                "" => printable_lines(name).into_owned(),
                version => printable_lines(&format!("{name} {version}")).into_owned(),
            };
            let libraries: Vec<String> = self.libraries.iter().map(library).collect();
            facts.push((format!("{role} libraries"), libraries.join(", ")));
        }
        if self.is_incomplete {
            facts.push((
                format!("{role} imports"),
                "incomplete: only the first files and libraries are listed".to_owned(),
            ));
        }
        facts
    }
}
