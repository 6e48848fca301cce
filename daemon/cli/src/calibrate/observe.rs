//! Observation of the sweep until it ends.

use std::collections::BTreeSet;

use peernet_agent::RunningAgent;
use peernet_analysis::calibration::Sample;
use peernet_clock::{SharedClock, Span};
use peernet_statistics::number::bytes;
use peernet_stream::{ClockSample, Event, FaultyHost, HostClock, IncidentKind, Outcome};

use super::plan::Plan;
use super::sweep::SweepDisplay;
use crate::foreground::{AgentEnd, PeerWait, PipelineActivity, RunObserver};

/// Minimum timeout for an absent peer. The time that remains of the sweep is added to the minimum.
const MIN_ABSENCE_TIMEOUT: Span = Span::from_seconds(10);

/// The peer cannot answer payloads of one of the sizes; the text names the size and the reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct UnmeasurableSize(pub(super) String);

/// Measurements of the sweep.
#[derive(Default)]
pub(super) struct SweepMeasurements {
    pub(super) samples: Vec<Sample>,
    pub(super) clocks: Vec<ClockSample>,
    /// The peer's own name.
    pub(super) cloud: Option<String>,
    /// `true` if the clock of either host was made wrong on purpose.
    pub(super) has_clock_fault: bool,
    /// Number of times that the peer came back after an absence with the same clock as before.
    pub(super) reconnections: u64,
}

/// Observer of the agent.
pub(super) struct SweepObserver<'a> {
    plan: &'a Plan,
    clock: SharedClock,
    progress: SweepDisplay,
    pub(super) measurements: SweepMeasurements,
    peer_wait: PeerWait,
    /// Kind of the incident at the first attempt to connect, if the peer was absent or refused the session.
    first_attempt_failure: Option<IncidentKind>,
    /// Sizes of which at least one payload was sent.
    tried_sizes: BTreeSet<u64>,
    /// Last report about the peer's clock.
    cloud_clock: Option<HostClock>,
    /// `true` if the peer returned with another clock. Later measurements are then not part of the study.
    has_other_clock: bool,
}

impl<'a> SweepObserver<'a> {
    pub(super) fn new(plan: &'a Plan, clock: SharedClock, quiet: bool) -> Self {
        let now = clock.mono();
        Self {
            plan,
            progress: SweepDisplay::new(plan, quiet, now),
            clock,
            measurements: SweepMeasurements::default(),
            peer_wait: PeerWait::new(now),
            first_attempt_failure: None,
            tried_sizes: BTreeSet::new(),
            cloud_clock: None,
            has_other_clock: false,
        }
    }

    /// Handles a new session with the peer. Ends the study if the peer has another clock now.
    fn handle_reconnect(&mut self, clock: Option<HostClock>) -> Option<AgentEnd<UnmeasurableSize>> {
        self.peer_wait.record_answer(self.clock.mono());
        let previous_clock = std::mem::replace(&mut self.cloud_clock, clock);
        let new_clock = match (&previous_clock, &self.cloud_clock) {
            // If the same program is back, its clock fault is unchanged, and its count of steps is unchanged or
            // larger. After a restart of the program, both begin again.
            (Some(before), Some(now)) if before.faults == now.faults && before.epoch <= now.epoch => {
                self.measurements.reconnections += 1;
                return None;
            }
            (_, Some(HostClock { faults: Some(faults), .. })) => {
                format!("another clock, which is made wrong on purpose ({faults})")
            }
            (_, Some(_)) => "another clock".to_owned(),
            // The peer left again before its clock could be read.
            (_, None) => "an unknown clock".to_owned(),
        };
        self.has_other_clock = true;
        let name = self.measurements.cloud.as_deref().unwrap_or("the peer");
        let text = format!(
            "{name} disconnected and returned with {new_clock}: the study ends with the measurements until then"
        );
        Some(AgentEnd::Failed(text))
    }
}

impl RunObserver for SweepObserver<'_> {
    type OwnReason = UnmeasurableSize;

    fn handle_event(
        &mut self,
        event: Event,
        running: Option<&RunningAgent>,
    ) -> Option<AgentEnd<UnmeasurableSize>> {
        if self.has_other_clock {
            return None;
        }
        match event {
            Event::RunStarted(run) => {
                // There is one fact for each host with an artificial clock error.
                self.measurements.has_clock_fault |=
                    run.facts.iter().any(|(fact, _)| FaultyHost::from_fact_name(fact).is_some());
                self.measurements.cloud = run.placement.peer.map(|peer| peer.to_string());
                self.cloud_clock = running.and_then(cloud_clock);
                self.peer_wait.record_answer(self.clock.mono());
                self.progress.begin(self.peer_wait.last_present());
            }
            Event::Iteration(iteration) => {
                let sample = Sample::new(&iteration, self.plan.payload(iteration.number));
                let now = self.clock.mono();
                if sample.warm_up {
                    self.progress.record_warm_up(now);
                }
                // A peer answers with the error if its model fails, so a failed iteration counts as an answer, too.
                if matches!(iteration.outcome, Outcome::Ok | Outcome::Failed(_)) {
                    self.peer_wait.record_answer(now);
                }
                let (payload, is_first) =
                    (sample.payload_bytes, self.tried_sizes.insert(sample.payload_bytes));
                self.measurements.samples.push(sample);
                // Whatever fails the first payload of a size, such as the peer's size limit, would fail all payloads of
                // this size. The sweep therefore ends.
                if let (true, Outcome::Failed(reason)) = (is_first, &iteration.outcome) {
                    return Some(AgentEnd::OwnReason(UnmeasurableSize(describe_unmeasurable(
                        payload, reason,
                    ))));
                }
            }
            Event::Clock(clock_sample) => self.measurements.clocks.push(*clock_sample),
            Event::RunEnded(run) => {
                return Some(AgentEnd::from_run_end(run.reason, "sweep"));
            }
            Event::Incident(incident) => match incident.kind {
                IncidentKind::PipelineFailed => return Some(AgentEnd::Failed(incident.text)),
                IncidentKind::Disconnected | IncidentKind::Refused if self.measurements.cloud.is_none() => {
                    self.first_attempt_failure = Some(incident.kind);
                }
                IncidentKind::Connected if self.measurements.cloud.is_some() => {
                    return self.handle_reconnect(running.and_then(cloud_clock));
                }
                _ => {}
            },
            Event::Gap(_) => {}
        }
        None
    }

    fn poll_state(&mut self, running: &RunningAgent) -> Option<AgentEnd<UnmeasurableSize>> {
        let activity = PipelineActivity::current(running);
        let wait_reason = activity.wait_reason();
        if let (Some(kind), Some(reason)) = (self.first_attempt_failure, wait_reason) {
            let advice = match kind {
                IncidentKind::Refused => {
                    "; calibration needs the model `calibration`, which a peer serves if its configuration has [serve] calibration = true"
                }
                _ => "",
            };
            return Some(AgentEnd::Failed(format!("{reason}{advice}")));
        }
        let now = self.clock.mono();
        self.peer_wait.update(&activity, now);
        // An absent peer is waited for until shortly after the maximum duration of the sweep, but no longer than by other
        // commands.
        let remaining = self.progress.time_limit() - self.peer_wait.last_present();
        let timeout = (remaining + MIN_ABSENCE_TIMEOUT).clamp(MIN_ABSENCE_TIMEOUT, PeerWait::DEFAULT_TIMEOUT);
        let name = self.measurements.cloud.as_deref();
        let trouble = name.and_then(|name| self.peer_wait.describe_trouble(name, wait_reason, now, timeout));
        self.progress.show(&self.measurements.samples, now, trouble);
        self.peer_wait.timeout_reason(wait_reason, now, timeout).map(AgentEnd::Failed)
    }

    fn end_decided(&mut self) {
        self.progress.end();
    }
}

/// Returns the present report about the peer's clock.
fn cloud_clock(running: &RunningAgent) -> Option<HostClock> {
    running.live_update().links.into_iter().next()?.cloud
}

fn describe_unmeasurable(payload_bytes: u64, reason: &str) -> String {
    let payload = bytes(payload_bytes as f64).plain();
    format!(
        "cannot measure payloads of {payload}: {reason}; remove that size from --sizes, or raise the size limit of the peer ([serve] session)"
    )
}
