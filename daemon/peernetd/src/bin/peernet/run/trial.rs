//! A few iterations of each configuration before the first run: one refusal now is better than one after an hour.

use std::collections::BTreeSet;
use std::num::NonZeroU64;

use anyhow::{Context, anyhow};
use peernet_actuators::ActuatorConfig;
use peernet_agent::config::{Limit, LoadConfig, PlacementConfig, WarmUp};
use peernet_clock::SharedClock;
use peernet_logger::stream::{Condition, Grade};
use peernet_networks::Address;
use peernet_report::results::{Overwrite, ResultFolder, RunRecord};
use peernetd::exit::{Exit, Failure};

use super::children::{self, Exited};
use super::estimate::Pace;
use super::file::Configuration;
use super::plan::{Plan, in_words};
use crate::foreground::{Progress, Signals};
use crate::measure::Order;

/// Iterations of a trial: the first may be slow, of the others the pace is taken.
const ITERATIONS: u64 = 3;
/// How long a peer is waited for unless the file says otherwise; seconds. It may have to load its model.
const PATIENCE_S: f64 = 30.0;

/// What the trials showed.
pub(super) struct Tried {
    /// One for each configuration; `None` where it was not tried or did not work.
    pub(super) paces: Vec<Option<Pace>>,
    /// What is missing: configurations in words, and why.
    pub(super) missing: Vec<(String, Exited)>,
    /// What spoils measurements on a host, each once.
    pub(super) conditions: Vec<Condition>,
}

/// Tries the configurations at these places, each that is not like another before.
///
/// # Errors
/// When there is no place for files (69) or the user ended it (130).
pub(super) async fn configurations(
    plan: &Plan,
    wanted: &BTreeSet<usize>,
    clock: &SharedClock,
    signals: &mut Signals,
    quiet: bool,
) -> Result<Tried, Failure> {
    let folder = tempfile::Builder::new().prefix("peernet-trial-").tempdir();
    let folder = folder
        .context("cannot make a temporary folder; TMPDIR names another place")
        .map_err(|error| Failure::new(Exit::Unavailable, error))?;
    let mut tried =
        Tried { paces: vec![None; plan.configurations.len()], missing: Vec::new(), conditions: Vec::new() };
    let mut before: Vec<(Order, Option<Pace>)> = Vec::new();
    // Nobody is waited for twice.
    let mut away: Vec<(Address, Exited)> = Vec::new();
    let mut progress = Progress::new(quiet, clock.mono());
    for (done, &index) in wanted.iter().enumerate() {
        let Some(configuration) = plan.configurations.get(index) else { continue };
        let order = order(configuration);
        if let Some((_, pace)) = before.iter().find(|(other, _)| other.agent == order.agent) {
            tried.paces[index] = *pace;
            continue;
        }
        let peer = peer(&order);
        if let Some((_, exit)) = away.iter().find(|(other, _)| Some(other) == peer.as_ref()) {
            tried.missing.push((in_words(&configuration.labels), exit.clone()));
            continue;
        }
        let state = format!("trying {} of {}: {}", done + 1, wanted.len(), in_words(&configuration.labels));
        if !quiet {
            progress.say(&state);
        }
        let at = folder.path().join(index.to_string());
        let began = clock.mono();
        let orders = [Order { folder: at.clone(), ..order.clone() }];
        let share = done as f64 / wanted.len() as f64;
        let mut ended = children::execute(&orders, signals, |seen| {
            let trouble = seen.iter().flatten().find_map(|seen| seen.trouble.clone());
            progress.show(clock.mono(), trouble, || (state.clone(), share));
        })
        .await;
        if ended.interrupted {
            progress.end();
            return Err(Failure::new(Exit::Interrupted, anyhow!("ended before the first run")));
        }
        let loaded = ResultFolder::open(&at).ok();
        let took = (clock.mono() - began).seconds();
        match ended.exits.pop() {
            Some(exit) if exit.is_well() => {
                let moments = loaded.iter().flat_map(|loaded| &loaded.rows).map(|row| row.at);
                tried.paces[index] = pace(&moments.collect::<Vec<_>>(), took);
            }
            Some(exit) => {
                if took >= order.patience_s.unwrap_or(PATIENCE_S) {
                    away.extend(peer.map(|peer| (peer, exit.clone())));
                }
                tried.missing.push((in_words(&configuration.labels), exit));
            }
            None => {}
        }
        if let Some(loaded) = loaded {
            tell(&loaded.record, &mut tried.conditions);
        }
        before.push((order, tried.paces[index]));
    }
    progress.end();
    Ok(tried)
}

/// Who is asked.
fn peer(order: &Order) -> Option<Address> {
    match &order.agent.pipelines.first()?.placement {
        PlacementConfig::Remote(remote) => Some(remote.peer.clone()),
        PlacementConfig::Local { .. } | PlacementConfig::None {} => None,
    }
}

/// The configuration, short, and acting upon nothing.
fn order(configuration: &Configuration) -> Order {
    let mut agent = configuration.agent.clone();
    agent.agent.aggregator = None;
    for pipeline in &mut agent.pipelines {
        pipeline.limit = Limit { total: NonZeroU64::new(ITERATIONS), ..Limit::default() };
        pipeline.warm_up = WarmUp { iterations: 0, episodes: 0, steps: 0 };
        pipeline.episode_steps = None;
        pipeline.load = LoadConfig::Closed {};
        pipeline.actuator = ActuatorConfig::default();
    }
    Order {
        agent,
        title: in_words(&configuration.labels),
        folder: std::path::PathBuf::new(),
        overwrite: Overwrite::Refuse,
        plots: false,
        command: String::new(),
        warm_up: String::new(),
        patience_s: Some(configuration.patience_s.unwrap_or(PATIENCE_S)),
    }
}

/// The pace, from the moments at which iterations began and the time that all took.
fn pace(moments: &[f64], took: f64) -> Option<Pace> {
    let intervals = moments.windows(2).map(|pair| pair[1] - pair[0]);
    let iteration_s = intervals.filter(|interval| *interval > 0.0).reduce(f64::min)?;
    Some(Pace { iteration_s, beside_s: (took - iteration_s * moments.len() as f64).max(0.0) })
}

/// What spoils measurements, unless it was told before.
fn tell(record: &RunRecord, conditions: &mut Vec<Condition>) {
    let hosts = std::iter::once(&record.edge).chain(&record.cloud);
    let found = hosts.flat_map(|host| &host.conditions).filter(|found| found.grade >= Grade::Doubtful);
    for condition in found {
        let same = |other: &Condition| (&other.host, &other.about) == (&condition.host, &condition.about);
        if !conditions.iter().any(same) {
            conditions.push(condition.clone());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pace_is_that_of_the_iterations_after_the_first() {
        let pace = pace(&[10.0, 12.0, 12.5], 4.0).expect("three iterations");
        assert_eq!(pace, Pace { iteration_s: 0.5, beside_s: 2.5 });
        assert_eq!(super::pace(&[10.0], 1.0), None);
    }
}
