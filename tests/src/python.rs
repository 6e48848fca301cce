//! The Python interpreter for tests of custom objects.

use std::path::PathBuf;
use std::process::Command;

/// Returns a Python interpreter with numpy and PIL.
///
/// # Panics
/// If it does not exist.
pub fn python() -> PathBuf {
    let has_packages = |python: &PathBuf| {
        let run = Command::new(python).args(["-c", "import numpy, PIL"]).output();
        run.is_ok_and(|output| output.status.success())
    };
    let configured = std::env::var_os("PEERNET_PYTHON").map(PathBuf::from);
    let candidates = configured.into_iter().chain(["python3".into(), "/usr/bin/python3".into()]);
    candidates
        .into_iter()
        .find(has_packages)
        .expect("python3-numpy and python3-pil are installed: deploy/install-tools.sh test")
}
