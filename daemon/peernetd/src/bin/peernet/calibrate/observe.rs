//! Watching the sweep: what the agent measures, until it ends.

use std::time::Duration;

use peernet_agent::Running;
use peernet_clock::{MonoTime, SharedClock, Span};
use peernet_logger::stream::{ClockSample, Event, IncidentKind, PipelineState};
use peernet_report::calibration::Sample;
use peernetd::exit::{Exit, Failure};
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::plan::Plan;
use super::progress::Progress;

/// Between two looks at the clock.
const LOOK: Duration = Duration::from_millis(250);
/// How long a peer that went away is waited for.
const PATIENCE: Span = Span::from_seconds(90);

/// How the sweep ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Ended {
    /// All was sent, or the time was over.
    Finished,
    /// The user ended it.
    Interrupted,
    /// The peer or the agent could not go on; the text says why.
    Failed(String),
}

/// What was seen.
pub(super) struct Observed {
    pub(super) samples: Vec<Sample>,
    pub(super) clocks: Vec<ClockSample>,
    /// The peer, as it calls itself.
    pub(super) cloud: Option<String>,
    pub(super) ended: Ended,
    /// Whether the clock of either host was made wrong on purpose.
    pub(super) rehearsed: bool,
    /// Events that there was no room for.
    pub(super) missed: u64,
}

/// The eyes on the agent.
struct Watch<'a> {
    plan: &'a Plan,
    clock: &'a SharedClock,
    progress: Progress,
    seen: Observed,
    /// The last sign of the peer.
    heard: MonoTime,
    /// The peer was not there, or refused, at the first try.
    turned_away: Option<IncidentKind>,
}

/// Watches until the sweep ends, a signal comes or the peer stays away, then sees the agent to its end.
///
/// # Errors
/// When signals cannot be received or the agent loses a task.
pub(super) async fn observe(
    running: Running,
    stop: CancellationToken,
    mut events: mpsc::Receiver<Event>,
    plan: &Plan,
    clock: &SharedClock,
    progress: Progress,
) -> Result<Observed, Failure> {
    let unavailable = |error: std::io::Error| Failure::new(Exit::Unavailable, error);
    let mut interrupt = signal(SignalKind::interrupt()).map_err(unavailable)?;
    let mut terminate = signal(SignalKind::terminate()).map_err(unavailable)?;
    let mut look = tokio::time::interval(LOOK);
    let seen = Observed {
        samples: Vec::new(),
        clocks: Vec::new(),
        cloud: None,
        ended: Ended::Interrupted,
        rehearsed: false,
        missed: 0,
    };
    let mut watch = Watch { plan, clock, progress, seen, heard: clock.mono(), turned_away: None };
    watch.seen.ended = loop {
        let ended = tokio::select! {
            _ = interrupt.recv() => Some(Ended::Interrupted),
            _ = terminate.recv() => Some(Ended::Interrupted),
            event = events.recv() => match event {
                Some(event) => watch.take(event),
                None => Some(Ended::Failed("the agent ended by itself".to_owned())),
            },
            _ = look.tick() => watch.look(&running),
        };
        if let Some(ended) = ended {
            break ended;
        }
    };
    watch.progress.end();
    stop.cancel();
    watch.seen.missed = running.untapped();
    running.join().await.map_err(|error| Failure::new(Exit::Software, error))?;
    // What was under way when it ended.
    while let Ok(event) = events.try_recv() {
        watch.take(event);
    }
    Ok(watch.seen)
}

impl Watch<'_> {
    /// Takes an event; says how the sweep ended if it did.
    fn take(&mut self, event: Event) -> Option<Ended> {
        match event {
            Event::RunStarted(run) => {
                // One fact for each end whose clock is rehearsed.
                self.seen.rehearsed |= run.facts.iter().any(|(fact, _)| fact.starts_with("Rehearsal"));
                self.seen.cloud = run.placement.peer.map(|peer| peer.to_string());
                self.heard = self.clock.mono();
                self.progress.begin(self.heard);
            }
            Event::Iteration(iteration) => {
                let sample = Sample::new(&iteration, self.plan.payload(iteration.number));
                if sample.counts() || sample.warm_up {
                    self.heard = self.clock.mono();
                }
                self.seen.samples.push(sample);
            }
            Event::Clock(second) => self.seen.clocks.push(*second),
            Event::RunEnded(_) => return Some(Ended::Finished),
            Event::Incident(incident) => match incident.kind {
                IncidentKind::PipelineFailed => return Some(Ended::Failed(incident.text)),
                IncidentKind::Disconnected | IncidentKind::Refused if self.seen.cloud.is_none() => {
                    self.turned_away = Some(incident.kind);
                }
                _ => {}
            },
            Event::Gap(_) => {}
        }
        None
    }

    /// Shows the progress; says whether to give up.
    fn look(&mut self, running: &Running) -> Option<Ended> {
        if let Some(kind) = self.turned_away {
            let pipelines = running.live().pipelines;
            let state = pipelines.into_iter().next().map(|pipeline| pipeline.state);
            if let Some(PipelineState::Waiting(reason)) = state {
                let advice = match kind {
                    IncidentKind::Refused => {
                        "; calibrating needs the peer's model calibration, which its [serve] calibration = true offers"
                    }
                    _ => "",
                };
                return Some(Ended::Failed(format!("{reason}{advice}")));
            }
        }
        let now = self.clock.mono();
        self.progress.show(&self.seen.samples, now);
        let silent = now - self.heard;
        let text = format!("no answer for {:.0} s: gave up", silent.seconds());
        (silent > PATIENCE).then_some(Ended::Failed(text))
    }
}
