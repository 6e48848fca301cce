//! `peernet measure`: measures one requested run in a separate process.

use std::path::{Path, PathBuf};

use crate::exit::{Exit, Failure};
use crate::output::{print_to_stderr, print_to_stdout};
use crate::small_file;
use anyhow::{Context, anyhow};
use rustix::process::{Signal, set_parent_process_death_signal};

use super::{ProgressDisplay, ProgressReport, RunRequest, measure};
use crate::foreground::{LogDestination, start_log};

/// Line on standard output with which the process reports that its measurement has ended.
pub(crate) const MEASUREMENT_ENDED: &str = r#"{"measurement-ended":true}"#;

/// Arguments of `peernet measure`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// File with the description of the measurement, as JSON; `-` is standard input, with the description in one line.
    #[arg(long = "order", value_name = "ORDER")]
    request: PathBuf,
}

/// Measures the requested run. Prints each progress report as a line with a JSON object, and each
/// line of the log, which contains the output of custom code, as a line with a JSON string.
///
/// # Errors
/// Those of [`measure`]. Also when the request cannot be read (exit code 66) or parsed (exit code 78), `PEERNET_LOG` is
/// not a valid level (exit code 78), or iterations failed (exit code 75).
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    exit_with_parent();
    start_log(LogDestination::Parent)?;
    let is_from_parent = arguments.request == Path::new("-");
    let text = read(&arguments.request).map_err(|error| Failure::new(Exit::NoInput, error))?;
    let request: RunRequest = serde_json::from_str(&text).map_err(|error| {
        Failure::new(Exit::Configuration, anyhow!("cannot parse the description of the measurement: {error}"))
    })?;
    let measured = measure(&request, &mut JsonProgress { is_from_parent }).map_err(with_indented_lines)?;
    measured.failure().map_or(Ok(()), |failure| Err(with_indented_lines(failure)))
}

/// Indents all lines of a failure but the first. The experiment's process takes the last line that is not indented,
/// with the indented lines after it, as the failure. Without the indentation, this would be the last line of a Python
/// traceback only.
fn with_indented_lines(failure: Failure) -> Failure {
    let text = failure.to_string();
    if !text.contains('\n') {
        return failure;
    }
    let lines =
        text.lines().map(|line| if line.starts_with(' ') { line.to_owned() } else { format!("  {line}") });
    let text = lines.collect::<Vec<_>>().join("\n");
    Failure::new(failure.exit, anyhow!("{}", text.trim_start()))
}

/// Requests that the kernel kills this process when its parent, the experiment, ends. Otherwise
/// this process could write into a folder that a later run uses.
fn exit_with_parent() {
    if let Err(error) = set_parent_process_death_signal(Some(Signal::KILL)) {
        print_to_stderr(format_args!("this run may outlive its experiment: {error}"));
    }
}

fn read(file: &Path) -> anyhow::Result<String> {
    if file == Path::new("-") {
        let mut text = String::new();
        // The rest of standard input is read later: its end means that no edge of the run measures any more.
        std::io::stdin()
            .read_line(&mut text)
            .context("cannot read the description of the measurement from standard input")?;
        return Ok(text);
    }
    small_file::read(file, small_file::MAX_BYTES)
        .with_context(|| format!("cannot read the description of the measurement from {}", file.display()))
}

/// Display that prints the progress as JSON to standard output.
struct JsonProgress {
    /// `true` if the parent sent the request, and closes standard input when no edge of the run measures any more.
    is_from_parent: bool,
}

impl ProgressDisplay for JsonProgress {
    fn show(&mut self, report: &ProgressReport) {
        match serde_json::to_string(report) {
            Ok(line) => print_to_stdout(line),
            // These fields can always be serialised, so this does not happen.
            Err(error) => tracing::debug!(%error, "cannot write the progress report"),
        }
    }

    fn wait_for_other_edges(&mut self) {
        if !self.is_from_parent {
            return;
        }
        print_to_stdout(MEASUREMENT_ENDED);
        // The parent sends nothing more, so reading ends when the parent closes the pipe. After an error there is
        // nothing to wait for.
        if let Err(error) = std::io::copy(&mut std::io::stdin().lock(), &mut std::io::sink()) {
            tracing::debug!(%error, "cannot wait for the other edges of the run");
        }
    }
}
