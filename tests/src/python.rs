//! The Python interpreter for tests of users' objects.

use std::path::PathBuf;
use std::process::Command;

/// Returns a Python interpreter with numpy and PIL.
///
/// # Panics
/// If it does not exist.
pub fn python() -> PathBuf {
    let has_both = |python: &PathBuf| {
        let run = Command::new(python).args(["-c", "import numpy, PIL"]).output();
        run.is_ok_and(|output| output.status.success())
    };
    let named = std::env::var_os("PEERNET_PYTHON").map(PathBuf::from);
    let all = named.into_iter().chain(["python3".into(), "/usr/bin/python3".into()]);
    all.into_iter()
        .find(has_both)
        .expect("python3-numpy and python3-pil are installed: deploy/install-tools.sh test")
}
