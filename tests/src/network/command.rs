//! Execution of the tools that set up networks.

use std::process::Command;

/// Runs a tool and returns its output.
///
/// # Panics
/// If it cannot be started or fails.
pub(super) fn run(program: &str, arguments: &[&str]) -> String {
    try_run(program, arguments).unwrap_or_else(|problem| panic!("{problem}"))
}

/// Runs a tool that may fail. Returns its output, or a description of the failure.
pub(super) fn try_run(program: &str, arguments: &[&str]) -> Result<String, String> {
    let output = Command::new(program)
        .args(arguments)
        .output()
        .map_err(|error| format!("cannot run {program} ({error}): run `deploy/install-tools.sh test`"))?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    let stderr = String::from_utf8_lossy(&output.stderr);
    Err(format!("{program} {} failed: {}", arguments.join(" "), stderr.trim()))
}

pub(super) fn ip(arguments: &[&str]) -> String {
    run("ip", arguments)
}
