//! Paths in the checkout.

use std::path::{Path, PathBuf};

/// Returns the root of the checkout.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("tests/ stands in the checkout's root")
}

/// Returns a program that was built from this workspace into the folder of the running test.
///
/// # Panics
/// If it has not been built.
pub fn program(name: &str) -> PathBuf {
    let test = std::env::current_exe().expect("a running test has a path");
    // target/debug/deps/it-… → target/debug/NAME
    let path = test.parent().and_then(Path::parent).expect("tests run from target/PROFILE/deps").join(name);
    assert!(path.exists(), "{} does not exist: build it with `cargo build --workspace`", path.display());
    path
}

/// Returns the folder with ONNX Runtime's library.
///
/// # Panics
/// If `make setup` has not been run.
pub fn onnxruntime() -> PathBuf {
    let folder = root().join("onnxruntime/lib");
    assert!(folder.is_dir(), "{} does not exist: run `make setup`", folder.display());
    folder
}

/// Returns a program of chrony: from the package that was unpacked for the tests, or the system's.
///
/// # Panics
/// If `deploy/install-tools.sh test` has not been run.
pub fn chrony(name: &str) -> PathBuf {
    let tools = root().join(".venv-tools/chrony/usr");
    let folders = [tools.join("sbin"), tools.join("bin"), "/usr/sbin".into(), "/usr/bin".into()];
    let path = folders.iter().map(|folder| folder.join(name)).find(|path| path.exists());
    path.unwrap_or_else(|| panic!("{name} does not exist: run `deploy/install-tools.sh test`"))
}
