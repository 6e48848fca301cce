//! Which object, in which Python, and what may cross.

use std::collections::BTreeMap;
use std::num::NonZeroU64;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::PythonError;
use crate::process::{MAX_TIMEOUT_MS, impossible_variable};

/// `{ kind = "python", … }`
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PythonConfig {
    /// `module::object`: a class, which is instantiated without arguments, or an instance; `module` alone is the module
    /// itself.
    pub object: String,
    /// Where the module is looked for first and what the process has as its current directory. Default: that of this
    /// program.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub folder: Option<PathBuf>,
    /// The Python to run, such as that of a virtual environment. Default: `PEERNET_PYTHON`, else `python3`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub python: Option<PathBuf>,
    /// Environment variables for it.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub env: BTreeMap<String, String>,
    /// Pickle values that have no form of their own, and unpickle what arrives. A pickle runs code of whoever made it:
    /// only between hosts that trust each other. Default: no.
    #[serde(default)]
    pub pickle: bool,
    /// What a model is given for a picture. Default: `pil`.
    #[serde(default)]
    pub images: Images,
    /// How long one call may take; milliseconds, up to a day. The process is killed after that and started anew.
    /// Default: 60000.
    #[serde(default = "a_minute")]
    pub timeout_ms: NonZeroU64,
    /// How long importing the module and making the object may take; milliseconds, up to a day. Default: 300000.
    #[serde(default = "five_minutes")]
    pub start_timeout_ms: NonZeroU64,
}

/// What a picture becomes in Python.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Images {
    /// A `PIL.Image`; of a JPEG or PNG file one that is decoded when it is first used.
    #[default]
    Pil,
    /// Pixels as an array of shape height × width × channels; a file as `bytes`.
    Numpy,
    /// The bytes as they came.
    Bytes,
}

impl PythonConfig {
    /// An object with all defaults: what the command line's `module::object` means.
    pub fn of(object: &str) -> Self {
        Self {
            object: object.to_owned(),
            folder: None,
            python: None,
            env: BTreeMap::new(),
            pickle: false,
            images: Images::default(),
            timeout_ms: a_minute(),
            start_timeout_ms: five_minutes(),
        }
    }

    /// The module and the path of the object in it; the latter is empty for the module itself.
    pub(super) fn module_and_path(&self) -> Result<(&str, &str), PythonError> {
        let (module, path) = self.object.split_once("::").unwrap_or((&self.object, ""));
        if is_path(module) && (path.is_empty() && !self.object.contains("::") || is_path(path)) {
            return Ok((module, path));
        }
        Err(PythonError::Name(self.object.clone()))
    }

    /// Checks the numbers against their upper limits, and the names of variables.
    pub(super) fn check(&self) -> Result<(), PythonError> {
        if let Some(name) = impossible_variable(&self.env) {
            return Err(PythonError::Variable(name.to_owned()));
        }
        for (key, value) in [("timeout_ms", self.timeout_ms), ("start_timeout_ms", self.start_timeout_ms)] {
            if value.get() > MAX_TIMEOUT_MS {
                return Err(PythonError::TooMuch { key, value: value.get(), most: MAX_TIMEOUT_MS });
            }
        }
        Ok(())
    }
}

/// Names joined by dots, as Python has them.
fn is_path(text: &str) -> bool {
    let is_name = |name: &str| {
        name.chars().all(|c| c.is_alphanumeric() || c == '_') && !name.starts_with(|c: char| c.is_numeric())
    };
    text.split('.').all(|name| !name.is_empty() && is_name(name))
}

const fn a_minute() -> NonZeroU64 {
    NonZeroU64::new(60_000).expect("above 0")
}

const fn five_minutes() -> NonZeroU64 {
    NonZeroU64::new(300_000).expect("above 0")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_are_named_as_python_names_them() {
        let parts =
            |object| PythonConfig::of(object).module_and_path().map(|(a, b)| (a.to_owned(), b.to_owned()));
        for (object, module, path) in [
            ("camera::Camera", "camera", "Camera"),
            ("lab.robot::rig.left", "lab.robot", "rig.left"),
            ("plain", "plain", ""),
        ] {
            assert_eq!(parts(object).expect(object), (module.to_owned(), path.to_owned()));
        }
        for wrong in
            ["", "::", "camera::", "::Camera", "./camera.py::Camera", "a:b", "a::b::c", "1a::b", "a b::c"]
        {
            assert!(parts(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn the_short_form_is_the_default_and_misspelt_keys_are_refused() {
        let read = |text: &str| toml::from_str::<PythonConfig>(text);
        assert_eq!(read("object = 'a::b'").expect("reads"), PythonConfig::of("a::b"));
        assert!(read("object = 'a::b'\npikle = true").is_err());
        for (text, part) in [
            ("timeout_ms = 86400001", "86400000"),
            ("env = { 'a=b' = 'c' }", "\"a=b\""),
            ("env = { '' = 'c' }", "\"\""),
            ("env = { a = \"b\\u0000\" }", "\"a\""),
        ] {
            let config = read(&format!("object = 'a::b'\n{text}")).expect("reads");
            let error = config.check().expect_err(text).to_string();
            assert!(error.contains(part), "{error}");
        }
    }
}
