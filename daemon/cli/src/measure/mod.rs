//! One run in the foreground: an agent with one pipeline, and a folder of results that fills while it measures.
//!
//! ```text
//! RunRequest ── ReadyAgent ── events ── RunRecorder ─┬─ data.csv, row by row
//!                                     │              └─ ProgressReport, for the ProgressDisplay
//!                                     └─ record ── run.json, summary.*
//! ```
//!
//! The paper's command `--client` calls [`measure`] itself; an experiment starts one process for each of its runs
//! (`peernet measure --order FILE`), so that a crash affects one run only.

mod agent_end;
mod command;
mod previous_results;
mod progress_report;
mod record;
mod recorder;
mod results;
mod run_request;
mod spools;
mod state_dir;

pub(crate) use command::{Arguments, MEASUREMENT_ENDED, run};
pub(crate) use previous_results::previous_results_folder;
pub(crate) use progress_report::{Phase, ProgressDisplay, ProgressReport};
pub(crate) use run_request::RunRequest;
pub(crate) use spools::{AGENT_LOCK, UndeliveredEvents, spool_file, undelivered, undelivered_in_spool};
pub(crate) use state_dir::AgentStateDir;

use std::path::{Path, PathBuf};

use crate::exit::{Exit, Failure};
use anyhow::anyhow;
use peernet_actuators::ActuatorKind;
use peernet_analysis::WriteError;
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::Rows;
use peernet_analysis::sensor_study::SensorStudy;
use peernet_analysis::trust::{Report, TrustInput};
use peernet_figures as figures;
use peernet_results::SENSOR_STUDY;

use crate::foreground::{AgentEnd, AgentResult, ReadyAgent};
use recorder::RunRecorder;
use results::{Results, WrittenFiles};

/// Results of a run that has at least one row.
pub(crate) struct MeasuredRun {
    /// Reason why the agent ended.
    pub(crate) end: AgentEnd,
    /// Rows, one per iteration.
    pub(crate) rows: Rows,
    /// Everything else about the run.
    pub(crate) record: RunRecord,
    /// Folder of its results: the requested folder, or a temporary one if the requested folder could not be written.
    pub(crate) folder: PathBuf,
    /// Files in the folder.
    pub(crate) files: Vec<PathBuf>,
    /// Reason why results are missing or are not in the requested folder.
    trouble: Option<String>,
}

impl MeasuredRun {
    /// Returns the failure of a run with results, if any.
    pub(crate) fn failure(&self) -> Option<Failure> {
        let unwritten = |trouble: &String| Failure::new(Exit::Unwritten, anyhow!("{trouble}"));
        self.trouble
            .as_ref()
            .map(unwritten)
            .or_else(|| self.end.failure(&self.rows, self.record.counts.unseen))
    }
}

/// Measures the requested run and writes its results.
///
/// # Errors
/// When the configuration is wrong (exit code 78), the agent cannot start (exit code 69), or the folder for the results
/// cannot be used (exit code 64, 69 or 73). Also when there are no rows, because the peer or the agent failed (exit
/// code 69) or the user ended the run before the first iteration (exit code 130).
pub(crate) fn measure(
    request: &RunRequest,
    progress_display: &mut dyn ProgressDisplay,
) -> Result<MeasuredRun, Failure> {
    let pipeline = request.pipeline()?;
    let state_dir = AgentStateDir::for_agent(&request.agent.agent)?;
    let mut config = request.agent.clone();
    state_dir.configure(&mut config)?;
    let mut ready = ReadyAgent::new(config)?;
    // A trial runs without the actuator of the later runs. The actuator is created here and dropped
    // at once, so that an error of its creation ends the trial.
    if let Some(actuator) = &request.tried_actuator {
        actuator.try_build(&ready.clock).map_err(|error| {
            Failure::new(Exit::Unavailable, anyhow!("the actuator cannot be created: {error}"))
        })?;
    }
    let mut results = Results::prepare(request)?;
    ready.results_dir = Some(results.path().to_owned());
    let mut recorder = RunRecorder::new(
        pipeline,
        request.peer_timeout(),
        results.create_writer()?,
        ready.clock.clone(),
        progress_display,
    );
    let result = ready.watch(&mut recorder);
    let recorded = recorder.finish();
    progress_display.wait_for_other_edges();
    let (AgentResult { end, name, missed_iterations }, recorded) = match (result, recorded) {
        (Ok(result), recorded) => (result, recorded),
        (Err(failure), recorded) if recorded.rows.is_empty() => {
            results.discard();
            return Err(failure);
        }
        // The agent failed after iterations were recorded, so the run has results.
        (Err(failure), recorded) => (
            AgentResult {
                end: AgentEnd::Failed(failure.to_string()),
                name: String::new(),
                missed_iterations: 0,
            },
            recorded,
        ),
    };
    if recorded.rows.is_empty() {
        results.discard();
        return Err(end.failure_without_rows());
    }
    let mut record = record::run_record(request, &recorded, &end, name, missed_iterations);
    record.trust = Some(Report::new(&TrustInput::from_run(&record, &recorded.rows)));
    let WrittenFiles { folder, mut files, mut trouble } = results.finish(&record, &recorded.rows);
    let is_written = !files.is_empty();
    // If the rows did not fit on the disk, the earlier results may have been restored to the folder. Then nothing is
    // added to the earlier results.
    match is_written.then(|| write_sensor_study(&record, &recorded.rows, &folder)).transpose() {
        Ok(written) => files.extend(written.flatten()),
        Err(error) => trouble = trouble.or_else(|| Some(error.to_string())),
    }
    if request.plots && !is_written {
        // The disk has no space for the rows, so it has none for figures.
        trouble = trouble.map(|trouble| format!("{trouble}; no figure is drawn"));
    } else if request.plots {
        match figures::of_run(&record, &recorded.rows, &folder) {
            Ok(drawn) => files.extend(drawn),
            Err(error) => {
                let path = folder.display();
                let text = format!(
                    "not all figures are drawn: {error}; the measurements are complete, and `peernet plot {path}` draws the figures"
                );
                trouble = trouble.or(Some(text));
            }
        }
    }
    Ok(MeasuredRun { end, rows: recorded.rows, record, folder, files, trouble })
}

/// Writes the study of a run that measures only a sensor.
fn write_sensor_study(record: &RunRecord, rows: &Rows, folder: &Path) -> Result<Option<PathBuf>, WriteError> {
    if !record.is_sensor_only() {
        return Ok(None);
    }
    let Some(study) = SensorStudy::from_rows(rows) else { return Ok(None) };
    let path = folder.join(SENSOR_STUDY);
    std::fs::write(&path, format!("{}\n", study.text().trim_end())).map_err(WriteError::at(&path))?;
    Ok(Some(path))
}

fn unavailable(text: &str) -> Failure {
    Failure::new(Exit::Unavailable, anyhow!("{text}"))
}
