//! Execution of the runs, one after the other.

use crate::exit::Failure;
use peernet_analysis::duration_estimates::DurationEstimates;
use peernet_analysis::record::User;
use peernet_clock::SharedClock;
use peernet_results::Overwrite;
use peernet_statistics::Summary;

use super::children::{self, ChildEvent, ProcessResults};
use super::external_files::ExternalFiles;
use super::finished_runs::load_results;
use super::folder::Folder;
use super::plan::Run;
use super::state::{Record, RunResult};
use crate::experiment::RunStatus;
use crate::foreground::{Progress, Signals, command_line, estimated_duration, long_duration};
use crate::measure::{ProgressReport, RunRequest};
use crate::short::shorten_label;

/// Execution of the runs of an experiment, with everything that it needs.
pub(super) struct Execution<'a> {
    pub(super) folder: &'a Folder,
    pub(super) record: &'a mut Record,
    pub(super) estimates: DurationEstimates,
    pub(super) clock: &'a SharedClock,
    pub(super) external_files: &'a ExternalFiles,
    pub(super) quiet: bool,
}

impl Execution<'_> {
    /// Executes the runs in their order until they are done or the user ends the experiment. Returns whether the user
    /// ended the experiment.
    ///
    /// # Errors
    /// When the progress cannot be recorded (exit code 73).
    pub(super) async fn execute_all(&mut self, runs: &[Run], signals: &mut Signals) -> Result<bool, Failure> {
        for (done, run) in runs.iter().enumerate() {
            if self.execute_run(runs, done, run, signals).await? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Executes `run`, which `runs` has at the index `done`. Returns whether the user ended the experiment.
    async fn execute_run(
        &mut self,
        runs: &[Run],
        done: usize,
        run: &Run,
        signals: &mut Signals,
    ) -> Result<bool, Failure> {
        // The results of an earlier attempt are removed before the run is recorded as running, so that they cannot be
        // taken for results of this attempt.
        self.folder.remove(run)?;
        self.record.start_run(run);
        self.folder.save(self.record)?;
        let mut progress = Progress::new(self.quiet, self.clock.mono());
        let quiet = self.quiet;
        let requests = self.requests(run);
        let began = self.clock.mono();
        let name = format!(
            "run {} of {} ({})",
            run.number,
            self.record.plan.runs.len(),
            shorten_label(&self.record.plan.describe(run))
        );
        let later_runs_s = self.remaining_s(&runs[done + 1..]);
        let (share_before, run_share) = (done as f64 / runs.len() as f64, 1.0 / runs.len() as f64);
        if !self.quiet {
            progress.print_line(format_args!("{name}: begins"));
        }
        let process_results = children::execute(&requests, signals, |event| {
            let report = match event {
                ChildEvent::Line(user, line) if requests.len() > 1 => {
                    return progress.print_line(format_args!("user {}: {line}", user + 1));
                }
                ChildEvent::Line(_, line) | ChildEvent::EndAnnouncement(line) => {
                    return progress.print_line(line);
                }
                ChildEvent::ProgressReport(reports) => combine(reports),
            };
            let Some(report) = report else { return };
            if let Some(failure) = report.first_failure.as_ref().filter(|_| !quiet) {
                progress.print_once(format_args!("{name}: {failure}"));
            }
            let left =
                report.left_s.zip(later_runs_s).map(|(run_s, later_s)| estimated_duration(run_s + later_s));
            let left = left.map_or_else(String::new, |left| format!(", {left} left in total"));
            let trouble = report.trouble.as_ref().map(|trouble| format!("{name}: {trouble}"));
            let state = || {
                // `left` replaces the time left of this run alone.
                (
                    format!("{name}: {}{left}", ProgressReport { left_s: None, ..report.clone() }),
                    share_before + report.fraction_done().unwrap_or(0.0) * run_share,
                )
            };
            progress.show(self.clock.mono(), trouble, state);
        })
        .await;
        progress.end();
        let seconds = (self.clock.mono() - began).seconds();
        let interrupted = process_results.interrupted;
        let result = run_result(self.folder, self.record, run, &process_results, seconds);
        // The duration of a failed run says nothing about later runs of this configuration.
        if result.status == RunStatus::Finished {
            self.estimates.record_duration(run.configuration, seconds);
        }
        let reason = result.reason.as_ref().map_or_else(String::new, |reason| format!(": {reason}"));
        if !self.quiet || result.status != RunStatus::Finished || !reason.is_empty() {
            progress.print_line(format_args!(
                "{name}: {} after {}{reason}",
                result.status.name(),
                long_duration(seconds)
            ));
        }
        self.record.end_run(run, result);
        self.folder.save(self.record)?;
        Ok(interrupted)
    }

    /// Makes one request for each edge. All edges send at the same time.
    fn requests(&self, run: &Run) -> Vec<RunRequest> {
        let plan = &self.record.plan;
        let configuration = plan.configuration(run);
        let users = configuration.users;
        let request = |(user, folder)| RunRequest {
            agent: plan.agent(run, user, &self.record.id),
            title: plan.title(run),
            folder,
            overwrite: Overwrite::Replace,
            plots: self.external_files.plots,
            command: command_line(),
            network_config: self.external_files.network(run).cloned(),
            user: (users > 1).then(|| User { number: user + 1, count: users }),
            warm_up: configuration.warm_up.clone(),
            peer_timeout_s: configuration.patience_s,
            tried_actuator: None,
        };
        (0..).zip(self.folder.results(plan, run)).map(request).collect()
    }

    /// Returns the estimated duration of runs; `None` if one is unknown.
    fn remaining_s(&self, runs: &[Run]) -> Option<f64> {
        runs.iter().map(|run| self.estimates.duration_s(run.configuration)).sum()
    }
}

/// Determines the result of a run from the results of its processes and from its folder.
pub(super) fn run_result(
    folder: &Folder,
    record: &Record,
    run: &Run,
    process_results: &ProcessResults,
    seconds: f64,
) -> RunResult {
    let first_failure =
        process_results.results.iter().enumerate().find(|(_, result)| !result.is_successful());
    let Some((user, result)) = first_failure else {
        return RunResult { status: RunStatus::Finished, exit: Some(0), reason: None, seconds };
    };
    // The result files decide, not the exit codes: all iterations may have been tried although some failed, and all
    // measurements may be written although a process was stopped before it had drawn all figures. The page Compare
    // decides by the stored end of the run in the same way.
    let status = if load_results(folder, record, run).is_ok() {
        RunStatus::Finished
    } else if process_results.interrupted {
        RunStatus::Interrupted
    } else {
        RunStatus::Failed
    };
    let user_prefix =
        if process_results.results.len() > 1 { format!("user {}: ", user + 1) } else { String::new() };
    let reason = result.reason.as_ref().map(|reason| format!("{user_prefix}{reason}"));
    RunResult { status, exit: result.code, reason, seconds }
}

/// Combines the progress of several users (edges at the same time): sums their counts, and merges their totals.
fn combine(reports: &[Option<ProgressReport>]) -> Option<ProgressReport> {
    let all: Vec<&ProgressReport> = reports.iter().flatten().collect();
    let (first, rest) = all.split_first()?;
    if rest.is_empty() {
        return Some((*first).clone());
    }
    let mut totals = Summary::default();
    all.iter().for_each(|report| totals.merge(&report.totals));
    Some(ProgressReport {
        phase: first.phase,
        done: all.iter().map(|report| report.done).sum(),
        failed: all.iter().map(|report| report.failed).sum(),
        failed_in_warm_up: all.iter().map(|report| report.failed_in_warm_up).sum(),
        first_failure: reports.iter().enumerate().find_map(|(user, report)| {
            let failure = report.as_ref()?.first_failure.as_ref()?;
            Some(format!("user {}: {failure}", user + 1))
        }),
        iterations: all.iter().map(|report| report.iterations).sum(),
        rate: all.iter().map(|report| report.rate).sum(),
        totals,
        left_s: all.iter().filter_map(|report| report.left_s).reduce(f64::max),
        trouble: all.iter().find_map(|report| report.trouble.clone()),
    })
}
