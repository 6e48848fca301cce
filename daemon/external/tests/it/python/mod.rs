//! Tests with objects in real Python processes.

mod actuators;
mod deaths;
mod facts;
mod failures;
mod hostile;
mod refusals;
mod transfer;
mod value_table;
mod values;

use std::fs;
use std::path::PathBuf;
use std::process::Command;
use std::sync::{Arc, OnceLock};

use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
use peernet_external::python::{PythonConfig, PythonError, PythonObject, Role};
use peernet_sample::{Description, Part};
use tempfile::TempDir;

fn clock() -> SharedClock {
    Arc::new(SystemClock::new(ClockIdentity::new("boot", "test")))
}

/// Returns a Python interpreter with numpy and PIL, which these tests need.
fn python() -> PathBuf {
    static INTERPRETER: OnceLock<PathBuf> = OnceLock::new();
    let has_packages = |python: &PathBuf| {
        let run = Command::new(python).args(["-c", "import numpy, PIL"]).output();
        run.is_ok_and(|output| output.status.success())
    };
    let find = || {
        let configured = std::env::var_os("PEERNET_PYTHON").map(PathBuf::from);
        let candidates = configured.into_iter().chain(["python3".into(), "/usr/bin/python3".into()]);
        candidates
            .into_iter()
            .find(has_packages)
            .expect("python3-numpy and python3-pil are installed: deploy/install-tools.sh")
    };
    INTERPRETER.get_or_init(find).clone()
}

/// Folder with the module `own`, and the configuration of an object in it.
struct Module {
    folder: TempDir,
    config: PythonConfig,
}

impl Module {
    /// Creates the folder. `object` is the name of the object: `own::Own`.
    fn new(source: &str, object: &str) -> Self {
        let folder = tempfile::tempdir().expect("there is room for a folder");
        fs::write(folder.path().join("own.py"), source).expect("it can be written");
        let mut config = PythonConfig::new(object);
        config.folder = Some(folder.path().to_owned());
        config.python = Some(python());
        Self { folder, config }
    }

    fn start(&self, role: Role) -> Result<PythonObject, PythonError> {
        PythonObject::start(&self.config, role, "test", None, &clock())
    }

    fn model(&self) -> PythonObject {
        self.start(Role::Model).unwrap_or_else(|error| panic!("{error}"))
    }

    fn sensor(&self) -> PythonObject {
        self.start(Role::Sensor).unwrap_or_else(|error| panic!("{error}"))
    }

    /// Returns the error of a start that must fail.
    fn start_error(&self, role: Role) -> String {
        self.start(role).expect_err("it cannot be started").to_string()
    }
}

fn bytes(content: &'static [u8]) -> Part {
    Part { description: Description::bytes(), bytes: content.into() }
}

/// Returns the result of a call that must succeed.
fn value(object: &mut PythonObject, parts: &[Part]) -> Vec<Part> {
    let result = object.call(parts).result.unwrap_or_else(|error| panic!("{error}"));
    result.expect("there is a value")
}

/// Returns the error of a call that must fail.
fn failure(object: &mut PythonObject, parts: &[Part]) -> String {
    object.call(parts).result.expect_err("it fails").to_string()
}
