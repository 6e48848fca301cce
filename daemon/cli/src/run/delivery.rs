//! Delivery of events that runs left in the spools of their hosts, because their aggregator could not be reached.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::anyhow;
use peernet_agent::spool::pending_events;
use peernet_agent::{Agent, AgentConfig, reach_aggregator};
use peernet_networks::Address;
use peernet_statistics::number::counted;
use tokio_util::sync::CancellationToken;

use super::agent_state_dirs::{AgentStateDirs, LockError};
use super::plan::Plan;
use crate::exit::{Exit, Failure};
use crate::foreground::Signals;
use crate::measure::{AgentStateDir, UndeliveredEvents, spool_file};
use crate::output::print_to_stderr;
use crate::{VERSION, clock};

/// Time after which a delivery is given up if the aggregator has stored nothing in this time.
const PROGRESS_TIMEOUT: Duration = Duration::from_secs(10);

/// A host of an experiment and an aggregator to which it streams.
struct StreamingHost {
    /// Configuration of its agent, without anything that measures or serves.
    agent: AgentConfig,
    state_dir: AgentStateDir,
    aggregator: Address,
    spool: PathBuf,
}

/// Warns, before the first run, of aggregators that cannot be reached.
pub(super) async fn warn_if_unreachable(aggregators: &[&Address]) {
    for aggregator in aggregators {
        if let Err(error) = reach_aggregator(aggregator).await {
            print_to_stderr(format_args!(
                "warning: the aggregator at {aggregator} cannot be reached ({error}); the runs are measured, and their events wait \
                 on this machine: the same command delivers them later"
            ));
        }
    }
}

/// Delivers the waiting events of a plan's hosts to the aggregators that can be reached. No run may be active, and
/// the state folders of the hosts must not be locked. A delivery that fails is reported, and its events stay in the
/// spool.
///
/// # Errors
/// When there is no folder for the state of the hosts (exit code 69).
pub(super) async fn deliver(plan: &Plan, signals: &mut Signals, quiet: bool) -> Result<(), Failure> {
    let mut hosts_with_events = Vec::new();
    for host in hosts(plan)? {
        // A spool that cannot be read is skipped: `describe_undelivered` reports it when the command ends.
        if host.spool.exists() && pending_events(&host.spool).await.is_ok_and(|events| events > 0) {
            hosts_with_events.push(host);
        }
    }
    let mut unreachable_aggregators: Vec<&Address> = Vec::new();
    let mut reached_aggregators: Vec<&Address> = Vec::new();
    for host in &hosts_with_events {
        let aggregator = &host.aggregator;
        if unreachable_aggregators.contains(&aggregator) {
            continue;
        }
        if !reached_aggregators.contains(&aggregator) {
            if reach_aggregator(aggregator).await.is_err() {
                unreachable_aggregators.push(aggregator);
                continue;
            }
            if !quiet {
                print_to_stderr(format_args!(
                    "delivering the events that wait for the aggregator at {aggregator}"
                ));
            }
            reached_aggregators.push(aggregator);
        }
        tokio::select! {
            result = deliver_events_of(host) => result.err().iter().for_each(print_to_stderr),
            _ = signals.next() => return Ok(()),
        }
    }
    Ok(())
}

/// Starts an agent of this host that only delivers, and stops it once its spool is empty or the aggregator stores
/// nothing more.
async fn deliver_events_of(host: &StreamingHost) -> Result<(), Failure> {
    let failure = |error: &dyn std::error::Error| {
        let at = &host.aggregator;
        let text = format!("cannot deliver the events that wait for the aggregator at {at}: {error}");
        Failure::new(Exit::Unavailable, anyhow!("{text}"))
    };
    let _lock = match AgentStateDirs::lock(&BTreeSet::from([host.state_dir.folder().to_owned()])) {
        Ok(lock) => lock,
        // If another process uses the host, that process delivers the events of the host.
        Err(LockError::InUse(_)) => return Ok(()),
        Err(error) => return Err(failure(&error)),
    };
    let mut config = host.agent.clone();
    host.state_dir.configure(&mut config)?;
    let clock = clock::system(&config.agent.clock_identity)
        .map_err(|error| Failure::new(Exit::Unavailable, error))?;
    let stop = CancellationToken::new();
    let running =
        Agent::start(config, VERSION, clock, stop.clone()).await.map_err(|error| failure(&error))?;
    running.wait_until_delivered(PROGRESS_TIMEOUT).await;
    stop.cancel();
    running.join().await.map_err(|error| failure(&error))
}

/// Returns the hosts of a plan that stream to an aggregator: one host for each spool.
fn hosts(plan: &Plan) -> Result<Vec<StreamingHost>, Failure> {
    let mut hosts: Vec<StreamingHost> = Vec::new();
    for run in &plan.runs {
        let configuration = plan.configuration(run);
        let agent_config = &configuration.agent;
        let Some(aggregator) = &agent_config.agent.aggregator else { continue };
        for user in 0..configuration.users {
            let AgentConfig { mut agent, spool, .. } = agent_config.clone();
            agent.name = plan.agent_name(run, user);
            let state_dir = AgentStateDir::for_agent(&agent)?;
            let file = spool.file.clone().unwrap_or_else(|| spool_file(state_dir.folder(), aggregator));
            if hosts.iter().any(|host| host.spool == file) {
                continue;
            }
            let agent = AgentConfig { agent, spool, ..AgentConfig::default() };
            hosts.push(StreamingHost { agent, state_dir, aggregator: aggregator.clone(), spool: file });
        }
    }
    Ok(hosts)
}

/// Describes the waiting events with a sentence for each aggregator. An aggregator of the plan is named by its
/// address as it is written in the experiment's file.
pub(super) fn describe_undelivered(
    undelivered: &[UndeliveredEvents],
    aggregators: &[&Address],
) -> Vec<String> {
    let mut names: Vec<&str> = undelivered.iter().map(UndeliveredEvents::aggregator).collect();
    names.sort_unstable();
    names.dedup();
    let counted_lines = names.into_iter().filter_map(|name| {
        let spools: Vec<&UndeliveredEvents> = undelivered
            .iter()
            .filter(|events| events.aggregator() == name && events.count().is_some())
            .collect();
        let first = spools.first()?;
        let events: u64 = spools.iter().filter_map(|events| events.count()).sum();
        let planned_address = aggregators.iter().find(|aggregator| first.is_for(aggregator));
        let (at, command) = match planned_address {
            Some(aggregator) => {
                (aggregator.to_string(), "the same command delivers them once it can be reached")
            }
            None => (name.to_owned(), "a run of the same hosts with that aggregator delivers them"),
        };
        let place = match spools.len() {
            1 => format!("in {}", first.file().display()),
            hosts => format!("on {hosts} hosts of this experiment"),
        };
        let verb = if events == 1 { "waits" } else { "wait" };
        let events = counted(events, "event");
        Some(format!("{events} {verb} for the aggregator at {at}, {place}; {command}"))
    });
    let unreadable = undelivered.iter().filter(|events| events.count().is_none()).map(ToString::to_string);
    counted_lines.chain(unreadable).collect()
}
