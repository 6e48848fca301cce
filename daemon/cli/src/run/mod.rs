//! `peernet run`: an experiment from one file.
//!
//! ```text
//! File ── configurations ── Plan ─┬─ trial        a few iterations of each configuration, before the first run
//!                                 ├─ Record       experiment.json: the state, replaced after every step
//!                                 ├─ execute      one process per run and user (`peernet measure`)
//!                                 └─ report       compare.*, users.*, sensors.*, figures
//! ```

mod agent_state_dirs;
mod arguments;
mod check;
mod children;
mod delivery;
mod end_requests;
mod execute;
mod exit_reason;
mod expected_duration;
mod external_files;
mod file;
mod finished_runs;
mod folder;
mod plan;
mod plan_differences;
mod relative_paths;
mod report;
mod sensors_table;
mod silence_detector;
mod state;
mod table;
mod trial;

pub(crate) use arguments::Arguments;

use std::collections::BTreeSet;
use std::io::{BufRead, IsTerminal, Write};
use std::path::{Path, PathBuf};

use crate::exit::{Exit, Failure};
use crate::experiment::RunStatus;
use crate::output::{print_to_stderr, print_to_stdout};
use crate::{VERSION, clock};
use anyhow::{Context, anyhow};
use peernet_analysis::duration_estimates::DurationEstimates;
use peernet_clock::{ClockIdentity, SharedClock};
use peernet_networks::Address;
use peernet_sample::printable_line;
use peernet_statistics::number::counted;

use crate::foreground::{Signals, dashboard_hint, describe_condition};
use agent_state_dirs::{AgentStateDirs, undelivered_events};
use arguments::RunSelection;
use children::ProcessResult;
use execute::Execution;
use expected_duration::expected_duration;
use external_files::ExternalFiles;
use file::File;
use finished_runs::{check_finished_runs, version_change_note};
use folder::Folder;
use plan::{Plan, Run};
use relative_paths::hint_at_relative_paths;
use report::Report;
use state::{Record, State};
use trial::TrialResults;

/// Default folder for the folders of experiments.
const DEFAULT_PARENT: &str = "results";

/// Executes an experiment, or continues one.
///
/// # Errors
/// When the file does not exist (exit code 66) or is wrong (exit code 78), something that it names is not available
/// (exit code 69), the folder holds other files (exit code 64), results cannot be written (exit code 73), some runs or
/// iterations failed (exit code 75), or the user ended the experiment early (exit code 130).
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let file = File::read(&arguments.file, &arguments.set)?;
    let (configurations, networks) = file.configurations(&arguments.models_dir)?;
    let external_files = ExternalFiles { plots: file.experiment.plots, networks };
    let clock =
        clock::system(ClockIdentity::SYSTEM).map_err(|error| Failure::new(Exit::Unavailable, error))?;
    // Only `--check` prints these problems. Without `--check`, the trials report them.
    let machine_problems = check::configurations(&arguments.file, &configurations, &clock)?;
    let path = arguments.result_loc.clone();
    let path = path.unwrap_or_else(|| PathBuf::from(DEFAULT_PARENT).join(file.experiment.name.as_str()));
    // The folder is locked before its record is read. Otherwise the record could lack the last runs of a command that
    // ends in between, and these runs would be measured again. A check and a dry run write nothing, so they need no
    // lock.
    let folder = if arguments.check || arguments.dry_run { None } else { Some(Folder::open(&path)?) };
    // `--restart` replaces the record, and `--check` checks the file only, so a broken record must not stop them.
    let existing_record = if arguments.restart || arguments.check { None } else { folder::load(&path)? };
    // A continued experiment keeps the seed of `--seed` although the option is not repeated; otherwise its plan would
    // differ.
    let seed = arguments.seed.or_else(|| existing_record.as_ref().map(|record| record.plan.seed));
    let plan = Plan::new(&file.experiment, seed, configurations);
    if let Some(unknown) = RunSelection::describe_unknown(&arguments.only, &plan) {
        if existing_record.is_none() {
            // No empty folder remains.
            folder.into_iter().for_each(Folder::discard);
        }
        return Err(Failure::new(Exit::Usage, anyhow!("--only: {unknown}")));
    }
    if arguments.check {
        let runs = counted(plan.runs.len() as u64, "run");
        let configurations = counted(plan.configurations.len() as u64, "configuration");
        machine_problems
            .iter()
            .for_each(|problem| print_to_stderr(format_args!("a problem of this machine only: {problem}")));
        hint_at_relative_paths(machine_problems.iter().map(String::as_str)).iter().for_each(print_to_stderr);
        print_to_stdout(format_args!("{}: {runs} of {configurations}", arguments.file.display()));
        return Ok(());
    }
    let record = match existing_record {
        Some(record) => {
            folder::ensure_unchanged(&record, &plan)?;
            record
        }
        None => Record::new(plan, random_id(), arguments.file.display().to_string(), VERSION.to_owned()),
    };
    // The processes of the runs do the work, so one thread is enough here.
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = runtime
        .context("cannot start the runtime")
        .map_err(|error| Failure::new(Exit::Unavailable, error))?;
    let experiment = (record, folder);
    let result = runtime.block_on(execute_experiment(arguments, experiment, &path, &clock, &external_files));
    // The thread that waits for an answer on the terminal is not waited for.
    runtime.shutdown_background();
    result
}

/// Executes an experiment with its results in the locked `folder` at `path`. A dry run has no locked folder.
async fn execute_experiment(
    arguments: &Arguments,
    (mut record, folder): (Record, Option<Folder>),
    path: &Path,
    clock: &SharedClock,
    external_files: &ExternalFiles,
) -> Result<(), Failure> {
    let mut signals = Signals::new().map_err(|error| Failure::new(Exit::Unavailable, error))?;
    if let Some(folder) = &folder {
        // Results may have been truncated or deleted since the last command; such runs are measured again.
        check_finished_runs(folder, &mut record, external_files);
    }
    let to_do = record.to_do(|run| RunSelection::selects(&arguments.only, &record.plan, run));
    version_change_note(&record, &to_do, VERSION).iter().for_each(print_to_stderr);
    let agent_state_dirs =
        match folder.as_ref().map(|_| AgentStateDirs::acquire(&record.plan, &to_do)).transpose() {
            Ok(agent_state_dirs) => agent_state_dirs,
            Err(failure) => {
                discard(folder, &record);
                return Err(failure);
            }
        };
    let tried_configurations: BTreeSet<usize> = to_do.iter().map(|run| run.configuration).collect();
    // Only configurations that have runs to do are tried: a continued experiment does not need the other peers.
    let trial_results = match trial::try_configurations(
        &record.plan,
        &tried_configurations,
        clock,
        &mut signals,
        arguments.quiet,
    )
    .await
    {
        Ok(trial_results) => trial_results,
        Err(failure) => {
            discard(folder, &record);
            return Err(failure);
        }
    };
    let estimates = estimates(&record, &trial_results);
    print_to_stdout(table::runs(&record, &estimates));
    let path_text = path.display().to_string();
    let path_text = printable_line(&path_text);
    print_to_stdout(format_args!(
        "\n{}; results in {path_text}",
        table::describe_plan(&to_do, &record, &estimates)
    ));
    for condition in &trial_results.conditions {
        print_to_stderr(describe_condition(condition));
    }
    delivery::warn_if_unreachable(&aggregators(&record.plan, &to_do)).await;
    // One unavailable configuration stops everything: an incomplete matrix cannot be compared.
    if let Some(failure) = unavailable_configurations(&trial_results, &arguments.file) {
        discard(folder, &record);
        return Err(failure);
    }
    let Some(folder) = folder else { return Ok(()) };
    if !to_do.is_empty() && !arguments.yes && !confirm(&mut signals).await {
        discard(Some(folder), &record);
        return Err(Failure::new(Exit::Interrupted, anyhow!("not started")));
    }
    if arguments.restart {
        // The earlier results are removed only now: they are kept if they cannot be measured again.
        clear(&folder)?;
    }
    folder.save(&record)?;
    let mut execution = Execution {
        folder: &folder,
        record: &mut record,
        estimates,
        clock,
        external_files,
        quiet: arguments.quiet,
    };
    let interrupted = execution.execute_all(&to_do, &mut signals).await?;
    let Report { text, figure_error } = report::write(&folder, &record, external_files.plots)?;
    print_to_stdout(format_args!("\n{text}"));
    print_to_stdout(format_args!("\n{path_text}: {}", summary(&record)));
    // The agents that deliver events lock the folders themselves.
    drop(agent_state_dirs);
    if !interrupted {
        delivery::deliver(&record.plan, &mut signals, arguments.quiet).await?;
    }
    let undelivered = undelivered_events(&record.plan).await?;
    let aggregators = aggregators(&record.plan, &record.plan.runs);
    for aggregator in &aggregators {
        let runs = format_args!("the runs of experiment {}", record.plan.name);
        let is_delivered = !undelivered.iter().any(|events| events.is_for(aggregator));
        print_to_stdout(dashboard_hint(runs, aggregator, is_delivered));
    }
    delivery::describe_undelivered(&undelivered, &aggregators).iter().for_each(print_to_stderr);
    // Runs that were finished by an earlier command count, too, so that repeating a command gives the same exit code.
    let selected_runs: Vec<Run> = record
        .runs()
        .map(|(run, _)| run.clone())
        .filter(|run| RunSelection::selects(&arguments.only, &record.plan, run))
        .collect();
    if let Some(error) = figure_error {
        let error = anyhow::Error::from(error).context(format!(
            "not all figures of the experiment are drawn; the tables are complete, and `peernet plot {path_text}` draws the figures"
        ));
        // A failure of the runs is reported, too; the exit code of the figures takes precedence.
        result_of_runs(&record, &selected_runs, interrupted).err().iter().for_each(print_to_stderr);
        return Err(Failure::new(Exit::Unwritten, error));
    }
    result_of_runs(&record, &selected_runs, interrupted)
}

/// Removes the tables, the figures, the runs and the record of an experiment that is restarted.
fn clear(folder: &Folder) -> Result<(), Failure> {
    folder.remove_tables_and_figures()?;
    match folder::load(folder.path()) {
        Ok(Some(old)) => return folder.clear(&old),
        Ok(None) => {}
        // The runs of an unreadable record are unknown. Each run replaces its folder when it is measured.
        Err(failure) => print_to_stderr(failure),
    }
    Ok(())
}

/// Estimates the durations of the runs. All durations are unknown if a trial failed, because then no run starts.
fn estimates(record: &Record, trial_results: &TrialResults) -> DurationEstimates {
    if !trial_results.unavailable.is_empty() {
        return DurationEstimates::new(vec![None; record.plan.configurations.len()]);
    }
    let expected_durations = record
        .plan
        .configurations
        .iter()
        .zip(&trial_results.paces)
        .map(|(configuration, pace)| expected_duration(&configuration.agent, configuration.users, *pace));
    let mut estimates = DurationEstimates::new(expected_durations.collect());
    // Measured durations of finished runs are better than estimates from trials.
    for (run, state) in record.runs().filter(|(_, state)| state.status == RunStatus::Finished) {
        state.seconds.into_iter().for_each(|seconds| estimates.record_duration(run.configuration, seconds));
    }
    estimates
}

/// Returns a failure with the reasons of all failed trials and their configurations; `None` if no trial failed.
fn unavailable_configurations(trial_results: &TrialResults, file: &Path) -> Option<Failure> {
    let (_, first) = trial_results.unavailable.first()?;
    let is_invalid_configuration =
        |result: &ProcessResult| result.code == Some(i32::from(Exit::Configuration as u8));
    let exit = if is_invalid_configuration(first) { Exit::Configuration } else { Exit::Unavailable };
    let mut reasons: Vec<&str> = Vec::new();
    let reason = |result: &ProcessResult| match &result.reason {
        Some(reason) if is_invalid_configuration(result) => {
            format!("{}: {}", file.display(), check::with_experiment_keys(reason))
        }
        Some(reason) => reason.clone(),
        None => "it gave no reason".to_owned(),
    };
    let all: Vec<(String, String)> = trial_results
        .unavailable
        .iter()
        .map(|(configuration, result)| (reason(result), configuration.clone()))
        .collect();
    for (reason, _) in &all {
        if !reasons.contains(&reason.as_str()) {
            reasons.push(reason);
        }
    }
    let hint = hint_at_relative_paths(reasons.iter().copied());
    let lines = reasons.into_iter().flat_map(|reason| {
        let affected =
            all.iter().filter(move |(other, configuration)| other == reason && !configuration.is_empty());
        std::iter::once(format!("  {reason}"))
            .chain(affected.map(|(_, configuration)| format!("    {configuration}")))
    });
    let (count, lines) = (all.len(), lines.chain(hint).collect::<Vec<_>>().join("\n"));
    let tried_count = counted(trial_results.configuration_count as u64, "configuration");
    Some(Failure::new(
        exit,
        anyhow!("{count} of {tried_count} cannot be measured, nothing was started:\n{lines}"),
    ))
}

/// Asks for confirmation if standard input is a terminal. Returns whether the runs may start.
async fn confirm(signals: &mut Signals) -> bool {
    // A script cannot answer.
    if !std::io::stdin().is_terminal() {
        return true;
    }
    let answer = tokio::task::spawn_blocking(|| {
        // If the question cannot be written, the answer is no.
        let mut errors = std::io::stderr();
        let _ = write!(errors, "start? [Y/n] ").and_then(|()| errors.flush());
        let mut answer = String::new();
        let read_bytes = std::io::stdin().lock().read_line(&mut answer).unwrap_or_default();
        read_bytes > 0 && !answer.trim().to_lowercase().starts_with('n')
    });
    tokio::select! {
        answer = answer => answer.unwrap_or(false),
        _ = signals.next() => false,
    }
}

/// Removes the folder of an experiment of which no run was started.
fn discard(folder: Option<Folder>, record: &Record) {
    if let Some(folder) = folder.filter(|_| record.states.iter().all(|state| state.attempts == 0)) {
        folder.discard();
    }
}

/// Returns the aggregators to which these runs are streamed, each once.
fn aggregators<'a>(plan: &'a Plan, runs: &[Run]) -> Vec<&'a Address> {
    let mut aggregators = Vec::new();
    for aggregator in runs.iter().filter_map(|run| plan.configuration(run).agent.agent.aggregator.as_ref()) {
        if !aggregators.contains(&aggregator) {
            aggregators.push(aggregator);
        }
    }
    aggregators
}

fn summary(record: &Record) -> String {
    let unfinished = [RunStatus::Failed, RunStatus::Interrupted, RunStatus::Running, RunStatus::Pending];
    let unfinished = unfinished.map(|status| (record.count(status), status));
    let unfinished = unfinished.iter().filter(|(count, _)| *count > 0);
    let unfinished: Vec<String> =
        unfinished.map(|(count, status)| format!(", {count} {}", status.name())).collect();
    let runs = counted(record.plan.runs.len() as u64, "run");
    format!("{} of {runs} finished{}", record.count(RunStatus::Finished), unfinished.concat())
}

/// Returns the failure for the selected runs, if there is one.
fn result_of_runs(record: &Record, selected_runs: &[Run], interrupted: bool) -> Result<(), Failure> {
    let states = || selected_runs.iter().filter_map(|run| record.states.get(run.number - 1));
    let failed = states().filter(|state| state.status == RunStatus::Failed).count();
    let finished = || states().filter(|state| state.status == RunStatus::Finished);
    // A process without an exit code was killed after it had written its results, while it drew the figures.
    let is_unwritten =
        |state: &&State| state.exit.is_none_or(|code| code == i32::from(Exit::Unwritten as u8));
    let unwritten = finished().filter(is_unwritten).count();
    let incomplete = finished().filter(|state| state.exit != Some(0) && !is_unwritten(state)).count();
    let mut clauses = Vec::new();
    if interrupted {
        clauses.push("ended early; the same command continues the experiment".to_owned());
    } else if failed > 0 {
        clauses.push(format!("{} failed; the same command tries again", counted(failed as u64, "run")));
    } else if incomplete > 0 {
        clauses.push(format!("iterations failed in {}", counted(incomplete as u64, "run")));
    }
    if unwritten > 0 {
        clauses.push(format!(
            "not all figures are drawn for {}, but the measurements are complete; `peernet plot` with the folder of a run draws its figures",
            counted(unwritten as u64, "run")
        ));
    }
    let exit = match (unwritten, interrupted) {
        _ if clauses.is_empty() => return Ok(()),
        (0, false) => Exit::Incomplete,
        (0, true) => Exit::Interrupted,
        _ => Exit::Unwritten,
    };
    Err(Failure::new(exit, anyhow!("{}", clauses.join("; "))))
}

/// Returns a random id of this execution. The id distinguishes executions of experiments with the same name.
fn random_id() -> String {
    format!("{:016x}", rand::random::<u64>())
}

#[cfg(test)]
mod tests;
