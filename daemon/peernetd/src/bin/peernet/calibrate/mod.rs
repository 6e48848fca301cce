//! `peernet calibrate`: the published study of a link as a command.
//!
//! A payload sweep is a run of the `synthetic` sensor: an agent in the foreground sends payloads of all sizes to a
//! peer's model `calibration`, which answers with what it was given, and [`peernet_report`] makes a study of it.

mod arguments;
mod folder;
mod observe;
mod plan;
mod progress;

pub(crate) use arguments::Arguments;

use std::sync::Arc;

use anyhow::{Context, anyhow};
use peernet_agent::Agent;
use peernet_clock::{SharedClock, WallTime};
use peernet_report::calibration::{Setting, Study};
use peernetd::exit::{Exit, Failure};
use peernetd::output::{complain, say};
use peernetd::{VERSION, clock};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use folder::Folder;
use observe::{Ended, Observed, observe};
use plan::Plan;
use progress::Progress;

/// Events between the agent and this program, which looks at each at once.
const EVENTS: usize = 4096;

/// Studies the link, prints the study and writes its files.
///
/// # Errors
/// When the peer cannot be reached or does not take part (69), the study has no result (69), the configuration is wrong
/// (78), the results cannot be written, or the user ended it early (130).
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let unavailable = |error: anyhow::Error| Failure::new(Exit::Unavailable, error);
    let plan = Plan::new(arguments).map_err(|error| Failure::new(Exit::Usage, error))?;
    let state = tempfile::tempdir().context("cannot make a temporary folder").map_err(unavailable)?;
    let config = plan.agent(arguments.config.as_deref(), state.path())?;

    let truth = clock::system(&config.agent.clock_identity).map_err(|error| unavailable(error.into()))?;
    let clock =
        clock::rehearsed(&truth, config.rehearsal.as_ref()).map_err(|error| unavailable(error.into()))?;
    let problems = Agent::check(&config, &clock);
    if !problems.is_empty() {
        let problems: Vec<String> = problems.iter().map(ToString::to_string).collect();
        return Err(Failure::new(Exit::Configuration, anyhow!("{}", problems.join("\n"))));
    }
    if let Some(rehearsal) = clock.rehearsal() {
        complain(format_args!("REHEARSAL: this host's wall clock is made wrong on purpose ({rehearsal})"));
    }
    let started = truth.wall();
    let folder = Folder::make(arguments, &arguments.peer, started)?;

    let progress = Progress::new(&plan, arguments.quiet, truth.mono());
    let (edge, observed) = measure(config, &plan, &clock, progress)?;
    let failed = match &observed.ended {
        Ended::Finished => None,
        Ended::Interrupted => Some(Failure::new(
            Exit::Interrupted,
            anyhow!("ended early: what was measured until then is above"),
        )),
        Ended::Unfit(reason) | Ended::Failed(reason) => Some(unavailable(anyhow!("{reason}"))),
    };
    if observed.samples.is_empty() || matches!(observed.ended, Ended::Unfit(_)) {
        folder.discard();
        return match failed {
            Some(Failure { exit: Exit::Interrupted, .. }) => {
                Err(Failure::new(Exit::Interrupted, anyhow!("ended before anything was measured")))
            }
            Some(failure) => Err(failure),
            None => Err(unavailable(anyhow!("nothing was measured"))),
        };
    }
    let setting = Setting {
        peer: arguments.peer.to_string(),
        edge,
        cloud: observed.cloud,
        network: arguments.network.name().to_owned(),
        started: rfc3339(started),
        version: VERSION.to_owned(),
        sizes_bytes: plan.sizes().to_vec(),
        repeats: arguments.repeats.get(),
        interrupted: observed.ended != Ended::Finished,
        ended: match &observed.ended {
            Ended::Failed(reason) => Some(reason.clone()),
            _ => None,
        },
        reconnections: observed.reconnections,
        rehearsed: observed.rehearsed,
    };
    let study = Study::new(setting, observed.samples, &observed.clocks);
    // Said first: a disk that is full must not take the result away.
    say(study.text());
    let written = study.write(folder.path()).map_err(|error| {
        unavailable(
            anyhow::Error::from(error).context("the result is above, but not all of its files are written"),
        )
    })?;
    let names: Vec<_> = written.iter().filter_map(|path| path.file_name()?.to_str()).collect();
    say(format_args!("\n{}: {}", folder.path().display(), names.join(", ")));
    if observed.missed > 0 {
        complain(format_args!("{} iterations went by unseen: this machine is too busy", observed.missed));
    }
    match failed {
        Some(failure) => Err(failure),
        None if study.verdict.kind.is_result() => Ok(()),
        None => Err(unavailable(anyhow!("the study has no result: {}", study.verdict.sentence))),
    }
}

/// Runs the agent until the sweep is done or ends otherwise; returns its name and what was seen.
fn measure(
    config: peernet_agent::AgentConfig,
    plan: &Plan,
    clock: &SharedClock,
    progress: Progress,
) -> Result<(String, Observed), Failure> {
    let unavailable = |error: anyhow::Error| Failure::new(Exit::Unavailable, error);
    let runtime = tokio::runtime::Builder::new_multi_thread().thread_name("peernet").enable_all().build();
    let runtime = runtime.context("cannot start the threads of the runtime").map_err(unavailable)?;
    runtime.block_on(async {
        let (stop, (tap, events)) = (CancellationToken::new(), mpsc::channel(EVENTS));
        let running = Agent::start_observed(config, Arc::clone(clock), stop.clone(), tap).await;
        let running = running.map_err(|error| unavailable(error.into()))?;
        let edge = running.name().to_string();
        let observed = observe(running, stop, events, plan, clock, progress).await?;
        Ok((edge, observed))
    })
}

fn rfc3339(at: WallTime) -> String {
    chrono::DateTime::from_timestamp_nanos(at.unix_nanos()).to_rfc3339_opts(chrono::SecondsFormat::Secs, true)
}
