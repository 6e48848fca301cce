//! `peernet calibrate`: the paper's study of a link as a command.
//!
//! A payload sweep is a run of the `synthetic` sensor: an agent in the foreground sends payloads of all sizes to a
//! peer's model `calibration`, which returns them, and [`peernet_analysis`] makes a study of the delays.

mod arguments;
mod folder;
mod observe;
mod plan;
mod sweep;

pub(crate) use arguments::Arguments;

use std::path::{Path, PathBuf};

use crate::VERSION;
use crate::exit::{Exit, Failure};
use crate::output::{print_to_stderr, print_to_stdout};
use anyhow::{Context, anyhow};
use peernet_analysis::WriteError;
use peernet_analysis::calibration::{Setting, Study};
use peernet_clock::WallTime;
use peernet_figures::draw_calibration;
use peernet_inference::LockedTempDir;
use peernet_statistics::number::counted;

use crate::foreground::{AgentEnd, AgentResult, LogDestination, ReadyAgent, start_log};
use folder::Folder;
use observe::{SweepObserver, UnmeasurableSize};
use plan::Plan;

/// Studies the link, prints the study and writes its files.
///
/// # Errors
/// When the arguments are wrong or the folder for the results is not empty (exit code 64), the
/// configuration cannot be read (exit code 66) or is wrong (exit code 78), the peer cannot be
/// reached or fails (exit code 69), the study has no result (exit code 69), the results cannot be
/// written (exit code 73), or the user ended the calibration early (exit code 130).
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let unavailable = |error: anyhow::Error| Failure::new(Exit::Unavailable, error);
    start_log(LogDestination::StandardError)?;
    let plan = Plan::new(arguments).map_err(|error| Failure::new(Exit::Usage, error))?;
    let state_dir = LockedTempDir::new("agent")
        .context("cannot create a temporary folder; set TMPDIR to another folder")
        .map_err(unavailable)?;
    let config = plan.agent(arguments.config.as_deref(), state_dir.path())?;

    let ready_agent = ReadyAgent::new(config)?;
    let started = ready_agent.system_clock.wall();
    // The folder is created after the check of the configuration, so that an invalid configuration leaves no folder.
    let folder = Folder::make(arguments, &plan.peer, started)?;

    let mut observer = SweepObserver::new(&plan, ready_agent.clock.clone(), arguments.quiet);
    let result = ready_agent.watch(&mut observer).inspect_err(|_| folder.discard());
    let AgentResult { end, name: edge, missed_iterations } = result?;
    let measurements = observer.measurements;
    let failure = match &end {
        AgentEnd::Finished => None,
        AgentEnd::Interrupted => Some(Failure::new(
            Exit::Interrupted,
            anyhow!("ended early: the results above cover the measurements until then"),
        )),
        AgentEnd::OwnReason(UnmeasurableSize(reason)) | AgentEnd::Failed(reason) => {
            Some(unavailable(anyhow!("{reason}")))
        }
    };
    // If a size cannot be measured, the sweep ends in its first round, in which each size is sent
    // once. The samples are then too few for a study.
    if measurements.samples.is_empty() || matches!(end, AgentEnd::OwnReason(_)) {
        folder.discard();
        return match failure {
            Some(Failure { exit: Exit::Interrupted, .. }) => {
                Err(Failure::new(Exit::Interrupted, anyhow!("ended before the first measurement")))
            }
            Some(failure) => Err(failure),
            None => Err(unavailable(anyhow!("nothing was measured"))),
        };
    }
    let setting = Setting {
        peer: plan.peer.to_string(),
        edge,
        cloud: measurements.cloud,
        network: plan.peer.network().name().to_owned(),
        started: rfc3339(started),
        version: VERSION.to_owned(),
        sizes_bytes: plan.sizes().to_vec(),
        repeats: arguments.repeats.get(),
        // `interrupted` is true for every early end. An end by the user has no `end_reason`.
        interrupted: end != AgentEnd::Finished,
        end_reason: match &end {
            AgentEnd::Failed(reason) => Some(reason.clone()),
            _ => None,
        },
        reconnections: measurements.reconnections,
        has_clock_fault: measurements.has_clock_fault,
    };
    let study = Study::new(setting, measurements.samples, &measurements.clocks);
    // Printed first: a full disk must not prevent the result from being shown.
    print_to_stdout(study.text());
    let written_files = write(&study, folder.path()).map_err(|error| {
        let message = "the result is shown above, but not all of its files were written";
        Failure::new(Exit::Unwritten, anyhow::Error::from(error).context(message))
    })?;
    let names: Vec<_> = written_files.iter().filter_map(|path| path.file_name()?.to_str()).collect();
    print_to_stdout(format_args!("\n{}: {}", folder.path().display(), names.join(", ")));
    if missed_iterations > 0 {
        let verb = if missed_iterations == 1 { "was" } else { "were" };
        print_to_stderr(format_args!(
            "{} {verb} not recorded: this machine is too busy",
            counted(missed_iterations, "iteration")
        ));
    }
    match failure {
        Some(failure) => Err(failure),
        None if study.verdict.kind.is_result() => Ok(()),
        None => Err(unavailable(anyhow!("the study has no result: {}", study.verdict.sentence))),
    }
}

fn rfc3339(at: WallTime) -> String {
    // `true` writes the time zone as `Z`.
    chrono::DateTime::from_timestamp_nanos(at.unix_nanos()).to_rfc3339_opts(chrono::SecondsFormat::Secs, true)
}

/// Writes the files of a study and its figures into a folder.
fn write(study: &Study, folder: &Path) -> Result<Vec<PathBuf>, WriteError> {
    let mut written_files = study.write(folder)?;
    written_files.extend(draw_calibration(study, folder)?);
    Ok(written_files)
}
