//! The lifecycle of a pipeline that observes: connect, wait for publishers, run, end.

use std::time::Duration;

use peernet_logger::RunId;
use peernet_stream::{EndReason, IncidentKind, PipelineState};

use super::peer::{PeerDescription, PeerStamps};
use super::session::{Observation, SessionEnd};
use super::source::{Source, SourceError, node_name};
use super::topic::{PublisherLocation, Topic};
use crate::config::ObserveConfig;
use crate::pipeline::placement::{conditions, describe_observed};
use crate::pipeline::run::Run;
use crate::pipeline::runner::{PipelineError, Runner};
use crate::reconnect_backoff::ReconnectBackoff;

/// Time after which it is reported that the input topic, the output topic or both have no publisher.
// Discovery may take several seconds, so missing publishers are not reported at once.
const PUBLISHER_TIMEOUT: Duration = Duration::from_secs(10);

/// Observes until the run reaches its limit or the agent stops. If the agent's ROS node ends, for example because the
/// ROS master is unreachable, the pipeline subscribes again.
///
/// # Errors
/// When the topics cannot be observed without a change of the configuration or of their types.
pub(in crate::pipeline) async fn run_to_end(
    runner: &Runner,
    config: &ObserveConfig,
) -> Result<(), PipelineError> {
    config.check_peer().map_err(SourceError::from)?;
    let mut active_run: Option<(Run, Observation<'_>)> = None;
    let mut reconnect_backoff = ReconnectBackoff::new(runner.context.host.id);
    let mut pause = Duration::ZERO;
    loop {
        let run_id = active_run.as_ref().map(|(run, _)| run.id());
        let connected = connect(runner, config, run_id, pause, &mut reconnect_backoff).await;
        let mut source = match connected {
            Ok(Some(source)) => source,
            Ok(None) => {
                if let Some(active_run) = active_run {
                    let loss_reason = "the agent stopped before the output message came";
                    end_without_source(active_run, loss_reason, EndReason::Stopped, runner).await;
                }
                return Ok(());
            }
            Err(error) => {
                if let Some(active_run) = active_run {
                    let loss_reason = "the topics could no longer be observed before the output message came";
                    let end_reason = EndReason::Failed(error.to_string());
                    end_without_source(active_run, loss_reason, end_reason, runner).await;
                }
                return Err(error.into());
            }
        };
        let (run, observation) = match &mut active_run {
            Some(active_run) => active_run,
            None => {
                let peer = PeerStamps::open(runner, config).await;
                if peer.is_none() && config.peer.is_some() {
                    // `open` retries until it succeeds, so a missing peer means that the agent stops.
                    source.close().await;
                    return Ok(());
                }
                let is_continuation = false;
                let run = start_run(runner, config, &source, peer.as_ref(), is_continuation).await;
                active_run.insert((run, Observation::new(config, runner, peer)))
            }
        };
        runner.live_state.set_state(PipelineState::Running);
        let connected_at = runner.context.host.clock.mono();
        let reason = loop {
            match observation.run(&mut source, run, runner).await {
                // A run without a limit ends at midnight (UTC), and a new run begins.
                SessionEnd::Midnight => {
                    run.end(EndReason::Finished, &runner.context);
                    // The subscriptions and the observation continue; only the run is a new one.
                    let is_continuation = true;
                    *run = start_run(runner, config, &source, observation.peer(), is_continuation).await;
                }
                SessionEnd::Limit => break Some(EndReason::Finished),
                SessionEnd::Stopped => break Some(EndReason::Stopped),
                SessionEnd::SourceLost(error) => {
                    report_problem(runner, run.id(), Some(&error.to_string()));
                    // The run continues with the next source.
                    break None;
                }
            }
        };
        pause = reconnect_backoff.pause_after_connection(runner.context.host.clock.mono() - connected_at);
        source.close().await;
        if let Some(reason) = reason {
            run.end(reason, &runner.context);
            if let Some((_, observation)) = active_run {
                observation.close().await;
            }
            return Ok(());
        }
    }
}

/// Ends a run that has no source at present. The open iterations are recorded as lost, with the text `loss_reason`.
async fn end_without_source(
    (mut run, mut observation): (Run, Observation<'_>),
    loss_reason: &str,
    end_reason: EndReason,
    runner: &Runner,
) {
    observation.abandon(loss_reason, &mut run, runner).await;
    run.end(end_reason, &runner.context);
    observation.close().await;
}

async fn start_run(
    runner: &Runner,
    config: &ObserveConfig,
    source: &Source,
    peer: Option<&PeerStamps>,
    is_continuation: bool,
) -> Run {
    let peer_description = peer.map(PeerStamps::peer_description);
    let conditions = conditions(
        peer_description.map(|peer_description| &*peer_description.conditions),
        &runner.context,
        is_continuation,
    )
    .await;
    let description =
        describe_observed(config, peer_description.map(|peer_description| peer_description.name.clone()));
    runner.live_state.set_placement(description.clone());
    runner.start_run(facts(config, source, peer_description), description, conditions, is_continuation)
}

/// Returns the facts about the observed system for the run's page.
fn facts(config: &ObserveConfig, source: &Source, peer: Option<&PeerDescription>) -> Vec<(String, String)> {
    let mut facts = vec![("Observed".to_owned(), source.describe())];
    for (role, topic) in [("Input", &source.input), ("Output", &source.output)] {
        let kind = topic.kind().map_or_else(String::new, |kind| format!(" ({})", kind.name));
        facts.push((role.to_owned(), format!("{}{kind}", topic.name())));
        facts.push((format!("{role} publishers"), describe_publishers(topic, peer)));
    }
    facts.push(("Paired by".to_owned(), config.pair_by.describe().to_owned()));
    facts.extend(peer.iter().flat_map(|peer| peer.facts.iter().cloned()));
    facts
}

fn describe_publishers(topic: &Topic, peer: Option<&PeerDescription>) -> String {
    let locations = topic.publishers();
    let is_peer =
        |location: &PublisherLocation| peer.is_some_and(|peer| peer.is_at(location.host.as_deref()));
    let locations: Vec<String> =
        locations.iter().map(|location| location.describe(is_peer(location))).collect();
    locations.join(", ")
}

/// Subscribes to both topics after a pause, and retries until that succeeds. If no run is in progress, also waits until
/// both topics have publishers. Returns `None` if the agent stops.
async fn connect(
    runner: &Runner,
    config: &ObserveConfig,
    run: Option<RunId>,
    mut pause: Duration,
    reconnect_backoff: &mut ReconnectBackoff,
) -> Result<Option<Source>, SourceError> {
    let host = &runner.context.host;
    let name = node_name(&host.name, &runner.config.name);
    let mut reported_error = String::new();
    loop {
        let opening = async {
            tokio::time::sleep(pause).await;
            Source::open(config, &name, &host.clock).await
        };
        let Some(opening_result) = runner.stop.run_until_cancelled(opening).await else { return Ok(None) };
        let error = match opening_result {
            Ok(mut source) => match await_publishers(runner, config, &mut source, run).await {
                Ok(true) => return Ok(Some(source)),
                // The agent stops.
                Ok(false) => {
                    source.close().await;
                    return Ok(None);
                }
                Err(error) => {
                    source.close().await;
                    error
                }
            },
            Err(error) => error,
        };
        // Retrying cannot correct a wrong configuration or type.
        if !error.is_temporary() {
            return Err(error);
        }
        let text = error.to_string();
        // The same error is reported once and not at every attempt.
        if reported_error != text {
            runner.report(IncidentKind::Disconnected, run, format!("{text} (retrying)"));
            reported_error.clone_from(&text);
        }
        runner.live_state.set_state(PipelineState::Waiting(text));
        pause = reconnect_backoff.next_pause();
    }
}

/// Waits until both topics have publishers, unless a run is in progress. Returns `false` if the agent stops.
async fn await_publishers(
    runner: &Runner,
    config: &ObserveConfig,
    source: &mut Source,
    run: Option<RunId>,
) -> Result<bool, SourceError> {
    let mut report_timer = std::pin::pin!(tokio::time::sleep(PUBLISHER_TIMEOUT));
    let mut is_reported = false;
    loop {
        source.follow_publishers()?;
        // The futures are created before the check, so that a change during the check is not missed.
        let (input, output) = (source.input.publishers_changed(), source.output.publishers_changed());
        source.check_types(config.pair_by)?;
        let Some(problem) = source.problem().filter(|_| run.is_none()) else { return Ok(true) };
        runner.live_state.set_state(PipelineState::Waiting(source.with_advice(&problem)));
        tokio::select! {
            () = input => {}
            () = output => {}
            error = source.ended() => return Err(error),
            () = runner.stop.cancelled() => return Ok(false),
            () = &mut report_timer, if !is_reported => {
                is_reported = true;
                let problem = format!("after {} s of waiting: {problem}", PUBLISHER_TIMEOUT.as_secs());
                let text = format!("{}; the run starts when both topics have a publisher", source.with_advice(&problem));
                runner.report(IncidentKind::Disconnected, None, text);
            }
        }
    }
}

/// Reports the reason why topics have no messages during a run. If `problem` is `None`, reports that both topics have a
/// publisher again.
pub(super) fn report_problem(runner: &Runner, run: RunId, problem: Option<&str>) {
    match problem {
        Some(problem) => {
            let text = format!("{problem}; the run continues when messages arrive again");
            runner.report(IncidentKind::Disconnected, Some(run), text);
            runner.live_state.set_state(PipelineState::Waiting(problem.to_owned()));
        }
        None => {
            let text = "both observed topics have a publisher again".to_owned();
            runner.report(IncidentKind::Connected, Some(run), text);
            runner.live_state.set_state(PipelineState::Running);
        }
    }
}
