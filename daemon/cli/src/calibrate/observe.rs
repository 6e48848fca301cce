//! Watching the sweep: what the agent measures, until it ends.

use std::collections::BTreeSet;

use peernet_agent::Running;
use peernet_analysis::calibration::Sample;
use peernet_clock::{MonoTime, SharedClock, Span};
use peernet_networks::OpenError;
use peernet_statistics::number::bytes;
use peernet_stream::{ClockSample, Event, HostClock, IncidentKind, Outcome};

use super::plan::Plan;
use super::sweep::Sweep;
use crate::foreground::{Ended, PeerWait, PipelineActivity, RunObserver};

/// How long a peer that went away is waited for once the time for the sweep is over.
const AFTER_THE_END: Span = Span::from_seconds(10);

/// The peer cannot answer a payload of one of the sizes; the text says which and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Unfit(pub(super) String);

/// What was seen.
#[derive(Default)]
pub(super) struct Observed {
    pub(super) samples: Vec<Sample>,
    pub(super) clocks: Vec<ClockSample>,
    /// The peer, as it calls itself.
    pub(super) cloud: Option<String>,
    /// Whether the clock of either host was made wrong on purpose.
    pub(super) rehearsed: bool,
    /// How often the peer was away and came back with the same clock.
    pub(super) reconnections: u64,
}

/// Observer of the agent.
pub(super) struct Watch<'a> {
    plan: &'a Plan,
    clock: SharedClock,
    progress: Sweep,
    pub(super) seen: Observed,
    began: MonoTime,
    peer_wait: PeerWait,
    /// The peer was not there, or refused, at the first try.
    turned_away: Option<IncidentKind>,
    /// The sizes of which one payload at least was sent.
    tried: BTreeSet<u64>,
    /// The peer's clock, as it was told last.
    cloud_clock: Option<HostClock>,
    /// What comes now is another clock's and no part of the study.
    over: bool,
}

impl<'a> Watch<'a> {
    pub(super) fn new(plan: &'a Plan, clock: SharedClock, quiet: bool) -> Self {
        let now = clock.mono();
        Self {
            plan,
            progress: Sweep::new(plan, quiet, now),
            clock,
            seen: Observed::default(),
            began: now,
            peer_wait: PeerWait::new(now),
            turned_away: None,
            tried: BTreeSet::new(),
            cloud_clock: None,
            over: false,
        }
    }

    /// There is a session again. What was measured with another clock is another study.
    fn came_back(&mut self, clock: Option<HostClock>) -> Option<Ended<Unfit>> {
        self.peer_wait.record_answer(self.clock.mono());
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
}

impl RunObserver for Watch<'_> {
    type Own = Unfit;

    fn take(&mut self, event: Event, running: Option<&Running>) -> Option<Ended<Unfit>> {
        if self.over {
            return None;
        }
        match event {
            Event::RunStarted(run) => {
                // One fact for each end whose clock is rehearsed.
                self.seen.rehearsed |= run.facts.iter().any(|(fact, _)| fact.starts_with("Rehearsal"));
                self.seen.cloud = run.placement.peer.map(|peer| peer.to_string());
                self.cloud_clock = running.and_then(cloud_clock);
                self.peer_wait.record_answer(self.clock.mono());
                self.progress.begin(self.peer_wait.last_present());
            }
            Event::Iteration(iteration) => {
                let sample = Sample::new(&iteration, self.plan.payload(iteration.number));
                if sample.counts() || sample.warm_up {
                    self.peer_wait.record_answer(self.clock.mono());
                }
                let (payload, first) = (sample.payload_bytes, self.tried.insert(sample.payload_bytes));
                self.seen.samples.push(sample);
                // What a peer cannot do the first time it will not do later either.
                if let (true, Outcome::Failed(reason)) = (first, &iteration.outcome) {
                    return Some(Ended::Own(Unfit(unfit(payload, reason))));
                }
            }
            Event::Clock(second) => self.seen.clocks.push(*second),
            Event::RunEnded(run) => {
                return Some(Ended::of_run(run.reason, "sweep"));
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

    fn look(&mut self, running: &Running) -> Option<Ended<Unfit>> {
        let activity = PipelineActivity::of(running);
        let waits_for = activity.waits_for();
        if let (Some(kind), Some(reason)) = (self.turned_away, waits_for) {
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
        self.peer_wait.update(&activity, now);
        // Who set an early end does not wait long after it for a peer that is away.
        let left = self.began + Span::from_seconds_f64(self.plan.seconds) - self.peer_wait.last_present();
        let most = (left + AFTER_THE_END).clamp(AFTER_THE_END, PeerWait::USUAL);
        let name = self.seen.cloud.as_deref();
        let trouble = name.and_then(|name| self.peer_wait.describe_trouble(name, waits_for, now, most));
        self.progress.show(&self.seen.samples, now, trouble);
        self.peer_wait.reason_to_give_up(waits_for, now, most).map(Ended::Failed)
    }

    fn over(&mut self) {
        self.progress.end();
    }
}

/// What is known of the peer's clock now.
fn cloud_clock(running: &Running) -> Option<HostClock> {
    running.live().links.into_iter().next()?.cloud
}

fn unfit(payload_bytes: u64, reason: &str) -> String {
    let payload = bytes(payload_bytes as f64).plain();
    format!(
        "payloads of {payload} cannot be measured: {reason}; leave that size out of --sizes, or allow more on the peer ([serve] session)"
    )
}
