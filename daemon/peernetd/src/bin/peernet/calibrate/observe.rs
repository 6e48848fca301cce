//! Watching the sweep: what the agent measures, until it ends.

use std::collections::BTreeSet;
use std::time::Duration;

use peernet_agent::Running;
use peernet_clock::{MonoTime, SharedClock, Span};
use peernet_logger::stream::{ClockSample, Event, HostClock, IncidentKind, Outcome, PipelineState};
use peernet_networks::OpenError;
use peernet_report::calibration::Sample;
use peernet_report::number::bytes;
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
/// The same once the time for the sweep is over.
const AFTER_THE_END: Span = Span::from_seconds(10);
/// How long it may stay silent before the user is told.
const SILENCE: Span = Span::from_seconds(3);

/// How the sweep ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Ended {
    /// All was sent, or the time was over.
    Finished,
    /// The user ended it.
    Interrupted,
    /// The peer cannot answer a payload of one of the sizes; the text says which and why.
    Unfit(String),
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
    /// How often the peer was away and came back with the same clock.
    pub(super) reconnections: u64,
    /// Events that there was no room for.
    pub(super) missed: u64,
}

/// The eyes on the agent.
struct Watch<'a> {
    plan: &'a Plan,
    clock: &'a SharedClock,
    progress: Progress,
    seen: Observed,
    began: MonoTime,
    /// The last sign of the peer.
    heard: MonoTime,
    /// The peer was not there, or refused, at the first try.
    turned_away: Option<IncidentKind>,
    /// The sizes of which one payload at least was sent.
    tried: BTreeSet<u64>,
    /// The peer's clock, as it was told last.
    cloud_clock: Option<HostClock>,
    /// What comes now is another clock's and no part of the study.
    over: bool,
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
        reconnections: 0,
        missed: 0,
    };
    let mut watch = Watch {
        plan,
        clock,
        progress,
        seen,
        began: clock.mono(),
        heard: clock.mono(),
        turned_away: None,
        tried: BTreeSet::new(),
        cloud_clock: None,
        over: false,
    };
    watch.seen.ended = loop {
        let ended = tokio::select! {
            _ = interrupt.recv() => Some(Ended::Interrupted),
            _ = terminate.recv() => Some(Ended::Interrupted),
            event = events.recv() => match event {
                Some(event) => watch.take(event, Some(&running)),
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
        watch.take(event, None);
    }
    Ok(watch.seen)
}

impl Watch<'_> {
    /// Takes an event; says how the sweep ended if it did.
    fn take(&mut self, event: Event, running: Option<&Running>) -> Option<Ended> {
        if self.over {
            return None;
        }
        match event {
            Event::RunStarted(run) => {
                // One fact for each end whose clock is rehearsed.
                self.seen.rehearsed |= run.facts.iter().any(|(fact, _)| fact.starts_with("Rehearsal"));
                self.seen.cloud = run.placement.peer.map(|peer| peer.to_string());
                self.cloud_clock = running.and_then(cloud_clock);
                self.heard = self.clock.mono();
                self.progress.begin(self.heard);
            }
            Event::Iteration(iteration) => {
                let sample = Sample::new(&iteration, self.plan.payload(iteration.number));
                if sample.counts() || sample.warm_up {
                    self.heard = self.clock.mono();
                }
                let (payload, first) = (sample.payload_bytes, self.tried.insert(sample.payload_bytes));
                self.seen.samples.push(sample);
                // What a peer cannot do the first time it will not do later either.
                if let (true, Outcome::Failed(reason)) = (first, &iteration.outcome) {
                    return Some(Ended::Unfit(unfit(payload, reason)));
                }
            }
            Event::Clock(second) => self.seen.clocks.push(*second),
            Event::RunEnded(run) => {
                return Some(match run.reason.as_str() {
                    "finished" => Ended::Finished,
                    reason => Ended::Failed(format!("the sweep ended early: {reason}")),
                });
            }
            Event::Incident(incident) => match incident.kind {
                IncidentKind::PipelineFailed => return Some(Ended::Failed(incident.text)),
                IncidentKind::Disconnected | IncidentKind::Refused if self.seen.cloud.is_none() => {
                    self.turned_away = Some(incident.kind);
                }
                IncidentKind::Connected if self.seen.cloud.is_some() => {
                    return self.came_back(running.and_then(cloud_clock));
                }
                _ => {}
            },
            Event::Gap(_) => {}
        }
        None
    }

    /// There is a session again. What was measured with another clock is another study.
    fn came_back(&mut self, clock: Option<HostClock>) -> Option<Ended> {
        self.heard = self.clock.mono();
        let before = std::mem::replace(&mut self.cloud_clock, clock);
        let how = match (&before, &self.cloud_clock) {
            // A program that was started anew rehearses anew, and counts the steps of its clock anew.
            (Some(before), Some(now)) if before.rehearsal == now.rehearsal && before.epoch <= now.epoch => {
                self.seen.reconnections += 1;
                return None;
            }
            (_, Some(HostClock { rehearsal: Some(how), .. })) => {
                format!("another clock, which is made wrong on purpose ({how})")
            }
            (_, Some(_)) => "another clock".to_owned(),
            // It went again before anybody could look.
            (_, None) => "a clock of which nothing is known".to_owned(),
        };
        self.over = true;
        let name = self.seen.cloud.as_deref().unwrap_or("the peer");
        let text = format!(
            "{name} went away and came back with {how}: the study ends with what was measured before"
        );
        Some(Ended::Failed(text))
    }

    /// Shows the progress; says whether to give up.
    fn look(&mut self, running: &Running) -> Option<Ended> {
        let pipelines = running.live().pipelines;
        let waits_for = match pipelines.into_iter().next().map(|pipeline| pipeline.state) {
            Some(PipelineState::Waiting(reason)) => Some(reason),
            _ => None,
        };
        if let (Some(kind), Some(reason)) = (self.turned_away, &waits_for) {
            // There is no configuration here, and the model is a mere echo.
            let reason = reason.strip_suffix(OpenError::LOADING).unwrap_or(reason);
            let advice = match kind {
                IncidentKind::Refused => {
                    "; calibrating needs the peer's model calibration, which its [serve] calibration = true offers"
                }
                _ => "",
            };
            return Some(Ended::Failed(format!("{reason}{advice}")));
        }
        let now = self.clock.mono();
        let silent = now - self.heard;
        // Who set an early end does not wait long after it for a peer that is away.
        let left = self.began + Span::from_seconds_f64(self.plan.seconds) - self.heard;
        let patience = (left + AFTER_THE_END).clamp(AFTER_THE_END, PATIENCE);
        let name = self.seen.cloud.as_deref().filter(|_| silent > SILENCE || waits_for.is_some());
        let trouble = name.map(|name| {
            let (silent, patience) = (silent.seconds(), patience.seconds());
            match &waits_for {
                Some(reason) => {
                    format!("{name} is away ({reason}); waiting for {silent:.0} s, at most {patience:.0} s")
                }
                None => format!("no answer from {name} for {silent:.0} s"),
            }
        });
        self.progress.show(&self.seen.samples, now, trouble);
        let reason = waits_for.map_or_else(String::new, |reason| format!(": {reason}"));
        let text = format!("gave up after {:.0} s without an answer{reason}", silent.seconds());
        (silent > patience).then_some(Ended::Failed(text))
    }
}

/// What is known of the peer's clock now.
fn cloud_clock(running: &Running) -> Option<HostClock> {
    running.live().links.into_iter().next()?.cloud
}

fn unfit(payload_bytes: u64, reason: &str) -> String {
    let payload = bytes(payload_bytes as f64);
    format!(
        "payloads of {payload} cannot be measured: {reason}; leave that size out of --sizes, or allow more on the peer ([serve] session)"
    )
}
