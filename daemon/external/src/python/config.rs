//! Configuration of a Python object: its name, its process, and the conversion of its values.

use std::collections::BTreeMap;
use std::num::NonZeroU64;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::PythonError;
use crate::process::{MAX_TIMEOUT_MS, invalid_variable};

/// Configuration of a Python object: `{ kind = "python", … }`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PythonConfig {
    /// Name of the object, `module::object`: a class, which is instantiated without arguments, or an instance.
    /// `module` alone stands for the module itself.
    pub object: String,
    /// Folder in which the module is searched first, and working directory of the process. Default: PEERNet's
    /// working directory.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub folder: Option<PathBuf>,
    /// Python interpreter, for example the interpreter of a virtual environment. Default: `PEERNET_PYTHON`, else
    /// `python3`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub python: Option<PathBuf>,
    /// Environment variables of the process.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub env: BTreeMap<String, String>,
    /// `true` to pickle values that have no other form, and to unpickle received values. Unpickling runs code of the
    /// sender, so both hosts must trust each other. Default: `false`.
    #[serde(default)]
    pub pickle: bool,
    /// Form of pictures that are passed to a model. Default: `pil`.
    #[serde(default)]
    pub images: Images,
    /// Longest time for one call, milliseconds, up to one day. Afterwards the process is killed and restarted.
    /// Default: 60000.
    #[serde(default = "one_minute")]
    pub timeout_ms: NonZeroU64,
    /// Longest time for importing the module and creating the object, milliseconds, up to one day. Default: 300000.
    #[serde(default = "five_minutes")]
    pub start_timeout_ms: NonZeroU64,
}

/// Python type of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Images {
    /// `PIL.Image`. A JPEG or PNG file is decoded when the image is first used.
    #[default]
    Pil,
    /// Pixels as an array of shape height × width × channels; a JPEG or PNG file as `bytes`.
    Numpy,
    /// The bytes as received.
    Bytes,
}

impl PythonConfig {
    /// Returns the configuration of an object with all defaults, as for `module::object` on the command line.
    pub fn new(object: &str) -> Self {
        Self {
            object: object.to_owned(),
            folder: None,
            python: None,
            env: BTreeMap::new(),
            pickle: false,
            images: Images::default(),
            timeout_ms: one_minute(),
            start_timeout_ms: five_minutes(),
        }
    }

    /// Returns the module and the path of the object in it; the path is empty for the module itself.
    pub(super) fn module_and_path(&self) -> Result<(&str, &str), PythonError> {
        let (module, path) = self.object.split_once("::").unwrap_or((&self.object, ""));
        if is_path(module) && (path.is_empty() && !self.object.contains("::") || is_path(path)) {
            return Ok((module, path));
        }
        Err(PythonError::Name(self.object.clone()))
    }

    /// Checks the timeouts against their upper limit, and the names and values of the environment variables.
    pub(super) fn check(&self) -> Result<(), PythonError> {
        if let Some(name) = invalid_variable(&self.env) {
            return Err(PythonError::Variable(name.to_owned()));
        }
        for (key, value) in [("timeout_ms", self.timeout_ms), ("start_timeout_ms", self.start_timeout_ms)] {
            if value.get() > MAX_TIMEOUT_MS {
                return Err(PythonError::AboveLimit { key, value: value.get(), most: MAX_TIMEOUT_MS });
            }
        }
        Ok(())
    }
}

/// Returns whether a text consists of Python names joined by dots.
fn is_path(text: &str) -> bool {
    let is_name = |name: &str| {
        name.chars().all(|c| c.is_alphanumeric() || c == '_') && !name.starts_with(|c: char| c.is_numeric())
    };
    text.split('.').all(|name| !name.is_empty() && is_name(name))
}

const fn one_minute() -> NonZeroU64 {
    NonZeroU64::new(60_000).expect("above 0")
}

const fn five_minutes() -> NonZeroU64 {
    NonZeroU64::new(300_000).expect("above 0")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn object_name_has_module_and_path() {
        let module_and_path = |object| {
            let config = PythonConfig::new(object);
            config.module_and_path().map(|(module, path)| (module.to_owned(), path.to_owned()))
        };
        for (object, module, path) in [
            ("camera::Camera", "camera", "Camera"),
            ("lab.robot::rig.left", "lab.robot", "rig.left"),
            ("plain", "plain", ""),
        ] {
            assert_eq!(module_and_path(object).expect(object), (module.to_owned(), path.to_owned()));
        }
        for wrong in
            ["", "::", "camera::", "::Camera", "./camera.py::Camera", "a:b", "a::b::c", "1a::b", "a b::c"]
        {
            assert!(module_and_path(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn defaults_are_used_and_invalid_keys_and_values_refused() {
        let read = |text: &str| toml::from_str::<PythonConfig>(text);
        assert_eq!(read("object = 'a::b'").expect("reads"), PythonConfig::new("a::b"));
        assert!(read("object = 'a::b'\npikle = true").is_err());
        for (text, expected_part) in [
            ("timeout_ms = 86400001", "86400000"),
            ("env = { 'a=b' = 'c' }", "\"a=b\""),
            ("env = { '' = 'c' }", "\"\""),
            ("env = { a = \"b\\u0000\" }", "\"a\""),
        ] {
            let config = read(&format!("object = 'a::b'\n{text}")).expect("reads");
            let error = config.check().expect_err(text).to_string();
            assert!(error.contains(expected_part), "{error}");
        }
    }
}
