//! The state of a link's clock relation on the edge. No I/O: the time is an argument.

use std::collections::BTreeSet;

use peernet_clock::{
    Direction, Doubt, ExchangeObservation, JudgedExchange, LearnResult, Offset, OneWayDelay, RawTime,
    RelatedClocks, Relation, Span, Stamp, Verdict, WallTime,
};
use peernet_logger::{HostId, Slug};
use peernet_networks::PeerClock;
use peernet_probes::ProbeResult;
use peernet_stream::{ClockSample, EstimateBasis, HostClock, NetworkName};

use super::announced_clock::AnnouncedClock;
use super::clock_window::ClockWindow;
use super::judged_stamps::{Crossing, HostStamp};
use super::network_sessions::NetworkSessions;
use super::reports::{ClockReports, ExcessSkew, LostProof, Restart, SuspectedJump};
use super::second::Second;
use crate::host_clock::describe_clock;
use crate::same_clock::NotProven;

/// Longest time between the end of a second and the time at which it counts as closed, unless exchanges stopped or
/// the wall clock was set.
const MAX_OVERDUE: Span = Span::from_seconds(2);

/// The clock relation of a link, and what the current second adds to it.
#[derive(Debug)]
pub(super) struct Knowledge {
    peer: HostId,
    name: Slug,
    relation: Relation,
    window: ClockWindow,
    second: Second,
    networks: NetworkSessions,
    edge: AnnouncedClock,
    cloud: AnnouncedClock,
    reports: ClockReports,
}

/// Samples to record and incidents to report.
#[derive(Debug, Default)]
#[must_use]
pub(super) struct KnowledgeChanges {
    /// Samples of the seconds that are over.
    pub(super) samples: Vec<ClockSample>,
    pub(super) restart: Option<Restart>,
    /// `true` if the cloud's wall clock was set or drifted away; no delay depends on it.
    pub(super) is_cloud_wall_set: bool,
    pub(super) jump: Option<SuspectedJump>,
    pub(super) excess: Option<ExcessSkew>,
    pub(super) lost_proof: Option<LostProof>,
}

/// A message that has arrived, and its number of bits.
#[derive(Clone, Copy, Debug)]
pub(super) struct MessageDelay {
    /// Difference of the wall-clock stamps.
    pub(super) raw: Span,
    pub(super) bits: Option<f64>,
}

impl Knowledge {
    pub(super) fn new(
        (peer, name): (HostId, Slug),
        relation: Relation,
        (edge, cloud): (PeerClock, PeerClock),
        now: Stamp,
    ) -> Self {
        let second = Second::new(now.wall.unix_seconds());
        let is_cloud_free_running = relation.settings().clocks == RelatedClocks::Raw;
        let edge = AnnouncedClock::new(edge, true, now.raw);
        let cloud = AnnouncedClock::new(cloud, is_cloud_free_running, now.raw);
        let mut knowledge = Self {
            peer,
            name,
            relation,
            window: ClockWindow::begin(),
            second,
            networks: NetworkSessions::default(),
            edge,
            cloud,
            reports: ClockReports::default(),
        };
        knowledge.disciplines(now.raw);
        knowledge
    }

    /// Records that a session over this network was opened.
    pub(super) fn join(&mut self, network: &NetworkName) {
        self.networks.join(network);
    }

    /// Records that a session over this network is over.
    pub(super) fn leave(&mut self, network: &NetworkName) {
        self.networks.leave(network);
    }

    /// Records the last sample of each network without sessions, after the session that probed is over and its probes
    /// are counted. Another session probes from now on.
    pub(super) fn settle_sessions(&mut self, now: Stamp) -> KnowledgeChanges {
        let mut changes = self.turn(now);
        for network in self.networks.take_ended(0) {
            if !self.second.is_empty() {
                let offset = self.relation.offset(now.raw, now.wall);
                changes.samples.push(self.sample(&network, now, offset));
                self.second.forget(&network);
            }
        }
        changes
    }

    /// Handles a completed exchange of data over a network: judges the delays of both directions.
    pub(super) fn judge(
        &mut self,
        network: &NetworkName,
        observation: &ExchangeObservation,
        [there, back]: [MessageDelay; 2],
        now: Stamp,
    ) -> ([OneWayDelay; 2], KnowledgeChanges) {
        let mut changes = self.turn(now);
        let JudgedExchange { learned, up, down } =
            self.update_relation(whose(observation), |relation| relation.judge(observation));
        // The raw value that is kept for ever is the difference of the wall clocks, whichever clocks are related.
        let (up, down) = (OneWayDelay { raw: there.raw, ..up }, OneWayDelay { raw: back.raw, ..down });
        self.learned(learned, observation, now, &mut changes);
        self.second.judged(network, Direction::Up, &up, there.bits);
        self.second.judged(network, Direction::Down, &down, back.bits);
        ([up, down], changes)
    }

    /// Handles a completed exchange of data during which one of the hosts' related clocks was interrupted.
    pub(super) fn stepped(
        &mut self,
        network: &NetworkName,
        message_delays: [MessageDelay; 2],
        now: Stamp,
    ) -> ([OneWayDelay; 2], KnowledgeChanges) {
        let changes = self.turn(now);
        let delays = message_delays.map(|message_delay| OneWayDelay {
            verdict: Verdict::Stepped,
            ..OneWayDelay::unsynchronised(message_delay.raw)
        });
        for (direction, (delay, message_delay)) in
            [Direction::Up, Direction::Down].iter().zip(delays.iter().zip(message_delays))
        {
            self.second.judged(network, *direction, delay, message_delay.bits);
        }
        (delays, changes)
    }

    /// Judges the delays of messages that others sent, one in each direction. Neither the relation nor the second
    /// learns from them, because the first stamp is that of another receiver and not of the departure.
    pub(super) fn judge_stamps(&self, up: &Crossing, down: Option<&Crossing>) -> [Option<OneWayDelay>; 2] {
        let is_current = |stamp: &HostStamp, clock: &AnnouncedClock| stamp.epoch == Some(clock.epoch());
        let is_up_current = is_current(&up.sender, &self.edge) && is_current(&up.receiver, &self.cloud);
        let is_down_current =
            |down: &Crossing| is_current(&down.sender, &self.cloud) && is_current(&down.receiver, &self.edge);
        if let Some(down) = down.filter(|down| is_up_current && is_down_current(down)) {
            let [there, back] = self.relation.differences(up.times(), down.times());
            return [Some(up.with_raw_difference(there)), Some(down.with_raw_difference(back))];
        }
        let judge = |crossing: &Crossing, is_current: bool, direction| {
            let (sent, received) = crossing.times();
            if is_current {
                crossing.with_raw_difference(self.relation.difference(direction, sent, received))
            } else {
                crossing.stepped()
            }
        };
        [
            Some(judge(up, is_up_current, Direction::Up)),
            down.map(|down| judge(down, is_down_current(down), Direction::Down)),
        ]
    }

    /// Handles the result of a probe.
    pub(super) fn probed(
        &mut self,
        result: &ProbeResult,
        authenticated: bool,
        now: Stamp,
    ) -> KnowledgeChanges {
        let mut changes = self.turn(now);
        let all = self.second.authenticated.unwrap_or(true);
        self.second.authenticated = Some(all && authenticated);
        let probes = &mut self.second.probes;
        match result {
            ProbeResult::Sent => probes.sent = probes.sent.saturating_add(1),
            ProbeResult::Lost => probes.lost = probes.lost.saturating_add(1),
            ProbeResult::Answered(observation) => {
                probes.answered = probes.answered.saturating_add(1);
                if self.learn(observation, now, &mut changes) {
                    self.second.round_trip(observation.exchange.round_trip());
                }
            }
            ProbeResult::Stepped(epoch) => {
                probes.answered = probes.answered.saturating_add(1);
                // Its stamps are from before and after a step of this host's clock, so that only the step is learnt.
                self.update_relation((*epoch, None), |relation| relation.edge_stepped(*epoch));
            }
            // The exchange was counted as answered before.
            ProbeResult::Refined(observation) => {
                self.learn(observation, now, &mut changes);
            }
            ProbeResult::Refused(_) => probes.refused = probes.refused.saturating_add(1),
            // It was counted as lost before.
            ProbeResult::Late => {}
        }
        changes
    }

    /// Handles the proof that both processes read one clock.
    pub(super) fn clock_proven(&mut self) {
        self.relation.set_same_clock(true);
        self.reports.proof_regained();
    }

    /// Handles an attempt that did not prove that both processes read one clock.
    pub(super) fn clock_not_proven(&mut self) {
        self.relation.set_same_clock(false);
    }

    /// Handles the loss of the proof that both processes read one clock.
    pub(super) fn proof_lost(&mut self, why: NotProven, now: RawTime) -> KnowledgeChanges {
        self.clock_not_proven();
        KnowledgeChanges { lost_proof: self.reports.proof_lost(why, now), ..KnowledgeChanges::default() }
    }

    /// Sets the epoch of this host's free-running clock.
    pub(super) fn begin_epoch_of_edge(&mut self, epoch: u32) {
        self.edge.begin_epoch(epoch);
    }

    /// Handles new information about this host's clocks.
    pub(super) fn edge_announced(&mut self, clock: PeerClock, now: RawTime) {
        if let Some(epoch) = self.edge.announce(clock, now) {
            self.update_relation((epoch, None), |relation| relation.edge_stepped(epoch));
        }
        self.disciplines(now);
    }

    /// Handles new information from the cloud about its clocks.
    pub(super) fn cloud_announced(&mut self, clock: PeerClock, now: RawTime) -> KnowledgeChanges {
        let before = self.cloud.wall_epoch();
        if let Some(epoch) = self.cloud.announce(clock, now) {
            self.update_relation((0, Some(epoch)), |relation| relation.cloud_stepped(epoch));
        }
        self.disciplines(now);
        let is_free_running = self.relation.settings().clocks == RelatedClocks::Raw;
        KnowledgeChanges {
            is_cloud_wall_set: is_free_running && self.cloud.wall_epoch() > before,
            ..KnowledgeChanges::default()
        }
    }

    /// Closes the current second if it is over.
    pub(super) fn turn(&mut self, now: Stamp) -> KnowledgeChanges {
        let mut changes = KnowledgeChanges::default();
        self.begin_window(now, &mut changes);
        if now.wall.unix_seconds() != self.second.at {
            self.disciplines(now.raw);
            changes.lost_proof = self.reports.second_over(now.raw);
            // If the clock was set back, the second is closed early; if it was set forward, it is closed as if it had
            // been on time.
            let end = self.second.end();
            let at = edge_time(now, end);
            let offset = self.relation.offset(at.raw, end);
            self.close(at, offset.as_ref(), now.wall, &mut changes);
        }
        changes
    }

    /// Closes the current second now, because nothing more will come.
    pub(super) fn finish(&mut self, now: Stamp) -> KnowledgeChanges {
        let mut changes = self.turn(now);
        let offset = self.relation.offset(now.raw, now.wall);
        self.close(now, offset.as_ref(), now.wall, &mut changes);
        changes
    }

    /// Returns the sample of the previous second of a network if it is available, else one of the current second so
    /// far.
    pub(super) fn now(&self, network: &NetworkName, now: Stamp) -> ClockSample {
        let previous = self.second.end() - Span::from_seconds(1);
        let current = now.wall.unix_seconds() == self.second.at;
        let last = self.window.last_second(network).filter(|last| current && last.at == previous);
        // After a step the new offset must not appear under the id of the window before it.
        let offset = || self.relation.offset(now.raw, now.wall).filter(|_| !self.window.is_void());
        last.cloned().unwrap_or_else(|| self.sample(network, now, offset()))
    }

    /// Returns the shown state of the clocks of the edge and the cloud.
    pub(super) fn clocks(&self) -> (HostClock, HostClock) {
        (describe_clock(self.edge.clock()), describe_clock(self.cloud.clock()))
    }

    /// Adds an exchange to the relation. Returns whether it was accepted.
    fn learn(
        &mut self,
        observation: &ExchangeObservation,
        now: Stamp,
        changes: &mut KnowledgeChanges,
    ) -> bool {
        let learned = self.update_relation(whose(observation), |relation| relation.learn(observation));
        self.learned(learned, observation, now, changes);
        !matches!(learned, LearnResult::Refused(_))
    }

    /// Passes something to the relation that came with these epochs of the related clocks of edge and cloud. If the
    /// relation restarts, the window becomes void, and a new epoch says whose clock was stepped.
    fn update_relation<T>(
        &mut self,
        (edge, cloud): (u32, Option<u32>),
        update: impl FnOnce(&mut Relation) -> T,
    ) -> T {
        let before = self.relation.counts().restarts;
        let answer = update(&mut self.relation);
        let edge_new = self.edge.begin_epoch(edge);
        let cloud_new = self.cloud.begin_epoch(cloud.unwrap_or(0));
        let restarted = self.relation.counts().restarts > before;
        if restarted {
            self.window.make_void();
        }
        self.reports.note_steps(restarted, (edge_new, cloud_new));
        answer
    }

    fn learned(
        &mut self,
        learned: LearnResult,
        observation: &ExchangeObservation,
        now: Stamp,
        changes: &mut KnowledgeChanges,
    ) {
        self.begin_window(now, changes);
        let settings = *self.relation.settings();
        match learned {
            LearnResult::Refused(_) => return,
            LearnResult::Taken => {}
            LearnResult::Restarted(moved) => {
                let limit = |doubt| match doubt {
                    Doubt::Drift => settings.max_drift_ppm,
                    Doubt::DriftChange => settings.max_drift_change_ppm_per_s,
                };
                let doubt = self.relation.doubt().map(|doubt| (doubt, limit(doubt)));
                changes.restart = self.reports.restarted(moved, doubt).or(changes.restart.take());
            }
            LearnResult::Jumped(moved) => {
                let jump = self.reports.jumped(moved, observation.exchange.returned);
                changes.jump = jump.or(changes.jump.take());
            }
        }
        let proven = self.relation.excess_skew();
        let excess = proven.map(|proven| ExcessSkew { proven, limit_ppm: settings.max_drift_ppm });
        changes.excess = self.reports.proven(excess).or(changes.excess.take());
        self.second.exchanged(&observation.exchange, settings.max_drift_ppm);
    }

    /// Begins a new window after a step. The exchanges of the current second belong to the clocks before the step, so
    /// that it is closed without an offset.
    fn begin_window(&mut self, now: Stamp, changes: &mut KnowledgeChanges) {
        if self.window.is_void() {
            let is_current = now.wall.unix_seconds() == self.second.at;
            let at = if is_current { now } else { edge_time(now, self.second.end()) };
            self.close(at, None, now.wall, changes);
            self.window = ClockWindow::begin();
        }
    }

    /// Closes the second with the state at `at`, its end, and begins the second of `now`.
    fn close(&mut self, at: Stamp, offset: Option<&Offset>, now: WallTime, changes: &mut KnowledgeChanges) {
        if !self.second.is_empty() {
            let networks: BTreeSet<&NetworkName> =
                self.networks.names().chain(self.second.networks()).collect();
            let sample = |network| self.sample(network, at, offset.cloned());
            let samples: Vec<ClockSample> = networks.into_iter().map(sample).collect();
            changes.samples.extend_from_slice(&samples);
            // For live updates, which show the last complete second.
            self.window.keep(samples);
        }
        self.networks.close_second();
        self.second = Second::new(now.unix_seconds());
    }

    fn sample(&self, network: &NetworkName, at: Stamp, offset: Option<Offset>) -> ClockSample {
        let settings = self.relation.settings();
        let basis = EstimateBasis {
            clocks: settings.clocks,
            at_raw: Some(at.raw),
            max_drift_change_ppm_per_s: settings
                .clocks
                .are_free_running()
                .then_some(settings.max_drift_change_ppm_per_s),
            proven_skew_ppm: self
                .relation
                .proven_skew()
                .map(|skew| (skew.least_ppm.min(skew.most_ppm), skew.most_ppm.max(skew.least_ppm))),
            grown_window: self.relation.window_reach(at.raw).filter(|reach| *reach > settings.window),
            claims_trusted: settings.trust_time_daemons,
            probes_authenticated: self.second.authenticated,
        };
        ClockSample {
            peer: self.peer,
            peer_name: self.name.clone(),
            at: at.wall,
            window: self.window.id(),
            max_drift_ppm: settings.max_drift_ppm,
            upper: self.second.upper,
            lower: self.second.lower,
            offset,
            probes: self.second.probes,
            exchanges: self.relation.counts(),
            round_trip: self.second.round_trips(),
            up: self.second.delays(network, Direction::Up),
            down: self.second.delays(network, Direction::Down),
            network: network.clone(),
            basis: Some(basis),
        }
    }

    /// Passes the current claims of the time daemons to the relation.
    fn disciplines(&mut self, now: RawTime) {
        let limit = self.relation.settings().max_drift_ppm;
        self.relation.set_disciplines(self.edge.claim(now, limit), self.cloud.claim(now, limit));
    }
}

/// Returns the edge's clocks at the wall-clock time `at`, shortly before `now`.
fn edge_time(now: Stamp, at: WallTime) -> Stamp {
    let since = (now.wall - at).max(Span::ZERO).min(MAX_OVERDUE);
    Stamp { wall: at, raw: now.raw - since, ..now }
}

/// Returns the epochs of edge and cloud in an exchange, which may arrive before the announcement of a new epoch.
const fn whose(observation: &ExchangeObservation) -> (u32, Option<u32>) {
    (observation.edge_epoch, observation.cloud_epoch)
}

#[cfg(test)]
mod tests;
