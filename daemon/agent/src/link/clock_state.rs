//! The clock relation of a link, on the edge. No I/O: the time is an argument.

use std::collections::BTreeSet;

use peernet_clock::{
    DelaySource, Direction, ExchangeObservation, JudgedExchange, LearnResult, Offset, OneWayDelay,
    ProvenSkew, RawTime, RelatedClocks, Relation, Span, Stamp, ViolatedLimit, WallTime,
};
use peernet_logger::{HostId, Slug};
use peernet_networks::PeerClock;
use peernet_probes::ProbeResult;
use peernet_stream::{ClockSample, EstimateBasis, HostClock, NetworkName};

use super::announced_clock::AnnouncedClock;
use super::link_second::{LinkSecond, count_probe};
use super::network_sessions::NetworkSessions;
use super::relation_period::RelationPeriod;
use super::reports::{ClockReports, ExcessSkew, LostProof, Restart, SuspectedJump};
use super::transit_stamps::{HostStamp, TransitStamps};
use crate::host_clock::describe_clock;
use crate::same_clock::NotProven;

/// Longest time between the end of a second and its close, unless exchanges stopped or the wall clock was set.
const MAX_OVERDUE: Span = Span::from_seconds(2);

/// The clock relation of a link, and what happened in the current second.
#[derive(Debug)]
pub(super) struct LinkClockState {
    peer: HostId,
    peer_name: Slug,
    relation: Relation,
    period: RelationPeriod,
    current_second: LinkSecond,
    networks: NetworkSessions,
    edge: AnnouncedClock,
    cloud: AnnouncedClock,
    reports: ClockReports,
}

/// Results of an update: clock samples to record and incidents to report.
#[derive(Debug, Default)]
#[must_use]
pub(super) struct ClockStateChanges {
    /// Clock samples of the closed seconds.
    pub(super) samples: Vec<ClockSample>,
    pub(super) restart: Option<Restart>,
    /// `true` if the cloud's wall clock was stepped or slewed, and no delay depends on this wall clock.
    pub(super) is_cloud_wall_set: bool,
    pub(super) jump: Option<SuspectedJump>,
    pub(super) excess_skew: Option<ExcessSkew>,
    pub(super) lost_proof: Option<LostProof>,
}

/// The raw delay of a message that has arrived, and its number of bits.
#[derive(Clone, Copy, Debug)]
pub(super) struct MessageDelay {
    /// Difference of the wall-clock stamps.
    pub(super) raw: Span,
    /// Number of bits of the message; `None` if it is unknown.
    pub(super) bits: Option<f64>,
}

impl LinkClockState {
    pub(super) fn new(
        (peer, peer_name): (HostId, Slug),
        relation: Relation,
        (edge, cloud): (PeerClock, PeerClock),
        now: Stamp,
    ) -> Self {
        let current_second = LinkSecond::new(now.wall.unix_seconds());
        // A link relates the edge's free-running clock to the cloud's free-running clock (`RelatedClocks::Raw`) or to
        // the cloud's wall clock (`RelatedClocks::RawToWall`).
        let is_edge_free_running = true;
        let is_cloud_free_running = relation.settings().clocks == RelatedClocks::Raw;
        let edge = AnnouncedClock::new(edge, is_edge_free_running, now.raw);
        let cloud = AnnouncedClock::new(cloud, is_cloud_free_running, now.raw);
        let mut clock_state = Self {
            peer,
            peer_name,
            relation,
            period: RelationPeriod::new(),
            current_second,
            networks: NetworkSessions::default(),
            edge,
            cloud,
            reports: ClockReports::default(),
        };
        clock_state.update_claims(now.raw);
        clock_state
    }

    /// Records that a session over this network was opened.
    pub(super) fn join(&mut self, network: &NetworkName) {
        self.networks.join(network);
    }

    /// Records that a session over this network has ended.
    pub(super) fn leave(&mut self, network: &NetworkName) {
        self.networks.leave(network);
    }

    /// Returns the last sample of each network without sessions. Called when the session that sent the probes has ended
    /// and all probes of that session are counted. Another session sends the probes from then on.
    pub(super) fn settle_sessions(&mut self, now: Stamp) -> ClockStateChanges {
        let mut changes = self.advance_second(now);
        // All probes are counted, so no network stays for further seconds.
        let closed_seconds = 0;
        for network in self.networks.take_ended(closed_seconds) {
            if !self.current_second.is_empty() {
                let offset = self.relation.offset(now.raw, now.wall);
                changes.samples.push(self.sample(&network, now, offset));
                self.current_second.remove_network(&network);
            }
        }
        changes
    }

    /// Handles a completed exchange of data over a network: judges the delays of both directions.
    pub(super) fn judge(
        &mut self,
        network: &NetworkName,
        observation: &ExchangeObservation,
        [up_message, down_message]: [MessageDelay; 2],
        now: Stamp,
    ) -> ([OneWayDelay; 2], ClockStateChanges) {
        let mut changes = self.advance_second(now);
        let JudgedExchange { learn_result, up, down } =
            self.update_relation(epochs_of(observation), |relation| relation.judge(observation));
        // The stored raw value is the difference of the wall clocks, also if other clocks are related.
        let (up, down) =
            (OneWayDelay { raw: up_message.raw, ..up }, OneWayDelay { raw: down_message.raw, ..down });
        self.handle_learn_result(learn_result, observation, now, &mut changes);
        self.current_second.add_delay(network, Direction::Up, &up, up_message.bits);
        self.current_second.add_delay(network, Direction::Down, &down, down_message.bits);
        ([up, down], changes)
    }

    /// Handles a completed exchange of data during which one of the hosts' related clocks was interrupted.
    pub(super) fn judge_interrupted(
        &mut self,
        network: &NetworkName,
        message_delays: [MessageDelay; 2],
        now: Stamp,
    ) -> ([OneWayDelay; 2], ClockStateChanges) {
        let changes = self.advance_second(now);
        let delays = message_delays.map(|message| OneWayDelay::stepped(message.raw, DelaySource::None));
        for (direction, (delay, message_delay)) in
            Direction::ALL.iter().zip(delays.iter().zip(message_delays))
        {
            self.current_second.add_delay(network, *direction, delay, message_delay.bits);
        }
        (delays, changes)
    }

    /// Judges the delays of observed messages, one in each direction.
    // These delays update neither the clock relation nor the current second. Both stamps of an observed message are
    // receptions: the departure of the message is not stamped.
    pub(super) fn judge_stamps(
        &self,
        up: &TransitStamps,
        down: Option<&TransitStamps>,
    ) -> [Option<OneWayDelay>; 2] {
        let is_up_current = is_current(&up.sender, &self.edge) && is_current(&up.receiver, &self.cloud);
        let is_down_current = |down: &TransitStamps| {
            is_current(&down.sender, &self.cloud) && is_current(&down.receiver, &self.edge)
        };
        if let Some(down) = down.filter(|down| is_up_current && is_down_current(down)) {
            let [up_difference, down_difference] =
                self.relation.reception_differences(up.times(), down.times());
            return [
                Some(up.with_raw_difference(up_difference)),
                Some(down.with_raw_difference(down_difference)),
            ];
        }
        let judge = |stamps: &TransitStamps, is_current: bool, direction| {
            let (sent, received) = stamps.times();
            if is_current {
                stamps.with_raw_difference(self.relation.reception_difference(direction, sent, received))
            } else {
                stamps.stepped_delay()
            }
        };
        [
            Some(judge(up, is_up_current, Direction::Up)),
            down.map(|down| judge(down, is_down_current(down), Direction::Down)),
        ]
    }

    /// Judges the delay of a partial answer.
    // It updates neither the clock relation nor the current second, because the final answer has updated both.
    pub(super) fn judge_partial_answer(&self, download: &TransitStamps) -> OneWayDelay {
        if !is_current(&download.sender, &self.cloud) || !is_current(&download.receiver, &self.edge) {
            return download.stepped_delay();
        }
        let (sent, received) = download.times();
        download.with_raw_difference(self.relation.delay(Direction::Down, sent, received))
    }

    /// Handles the result of a probe.
    pub(super) fn handle_probe_result(
        &mut self,
        result: &ProbeResult,
        authenticated: bool,
        now: Stamp,
    ) -> ClockStateChanges {
        let mut changes = self.advance_second(now);
        let all_authenticated = self.current_second.authenticated.unwrap_or(true);
        self.current_second.authenticated = Some(all_authenticated && authenticated);
        count_probe(&mut self.current_second.probes, result);
        match result {
            ProbeResult::Answered(observation) => {
                if self.learn(Relation::learn, observation, now, &mut changes) {
                    self.current_second.add_round_trip(observation.exchange.round_trip());
                }
            }
            ProbeResult::ClockInterrupted(epoch) => {
                // This host's clock was stepped between the stamps of the probe, so the relation learns only the step.
                self.update_relation((*epoch, None), |relation| relation.restart_after_edge_step(*epoch));
            }
            ProbeResult::Refined(observation) => {
                self.learn(Relation::refine, observation, now, &mut changes);
            }
            ProbeResult::Sent | ProbeResult::Lost | ProbeResult::Late | ProbeResult::Refused(_) => {}
        }
        changes
    }

    /// Handles the proof that both processes read one clock.
    pub(super) fn confirm_same_clock(&mut self) {
        self.relation.set_same_clock(true);
        self.reports.clear_ended_proof();
    }

    /// Handles a failed attempt to prove that both processes read one clock.
    pub(super) fn reject_same_clock(&mut self) {
        self.relation.set_same_clock(false);
    }

    /// Handles the loss of the proof that both processes read one clock.
    pub(super) fn handle_lost_proof(&mut self, reason: NotProven, now: RawTime) -> ClockStateChanges {
        self.reject_same_clock();
        ClockStateChanges {
            lost_proof: self.reports.report_lost_proof(reason, now),
            ..ClockStateChanges::default()
        }
    }

    /// Sets the epoch of this host's free-running clock.
    pub(super) fn begin_epoch_of_edge(&mut self, epoch: u32) {
        self.edge.begin_epoch(epoch);
    }

    /// Handles an announcement about this host's clocks.
    pub(super) fn handle_edge_announcement(&mut self, clock: PeerClock, now: RawTime) {
        if let Some(epoch) = self.edge.announce(clock, now) {
            self.update_relation((epoch, None), |relation| relation.restart_after_edge_step(epoch));
        }
        self.update_claims(now);
    }

    /// Handles an announcement of the cloud about its clocks.
    pub(super) fn handle_cloud_announcement(&mut self, clock: PeerClock, now: RawTime) -> ClockStateChanges {
        let old_epoch = self.cloud.wall_epoch();
        if let Some(epoch) = self.cloud.announce(clock, now) {
            // The announcement does not contain the edge's epoch. 0 is never newer than the latest known epoch.
            self.update_relation((0, Some(epoch)), |relation| relation.restart_after_cloud_step(epoch));
        }
        self.update_claims(now);
        let is_cloud_free_running = self.relation.settings().clocks == RelatedClocks::Raw;
        ClockStateChanges {
            is_cloud_wall_set: is_cloud_free_running && self.cloud.wall_epoch() > old_epoch,
            ..ClockStateChanges::default()
        }
    }

    /// Closes the current second if the second has passed.
    pub(super) fn advance_second(&mut self, now: Stamp) -> ClockStateChanges {
        let mut changes = ClockStateChanges::default();
        self.replace_void_period(now, &mut changes);
        self.update_claims(now.raw);
        if now.wall.unix_seconds() != self.current_second.start_s {
            changes.lost_proof = self.reports.report_ended_proof(now.raw);
            // If the clock was set back, the second is closed early. If it was set forward, the second is closed with
            // the state at its end.
            let end = self.current_second.end();
            let at = edge_time(now, end);
            let offset = self.relation.offset(at.raw, end);
            self.close_second(at, offset.as_ref(), now.wall, &mut changes);
        }
        changes
    }

    /// Closes the current second at the end of the link.
    pub(super) fn finish(&mut self, now: Stamp) -> ClockStateChanges {
        let mut changes = self.advance_second(now);
        let offset = self.relation.offset(now.raw, now.wall);
        self.close_second(now, offset.as_ref(), now.wall, &mut changes);
        changes
    }

    /// Returns the sample of a network's previous second if it is available, otherwise the sample of the current second
    /// so far.
    pub(super) fn latest_sample(&self, network: &NetworkName, now: Stamp) -> ClockSample {
        let previous_end = self.current_second.end() - Span::from_seconds(1);
        let is_current = now.wall.unix_seconds() == self.current_second.start_s;
        let previous_sample =
            self.period.last_second(network).filter(|sample| is_current && sample.at == previous_end);
        // After a step the new offset must not appear in the relation period that precedes the step.
        let offset = || self.relation.offset(now.raw, now.wall).filter(|_| !self.period.is_void());
        previous_sample.cloned().unwrap_or_else(|| self.sample(network, now, offset()))
    }

    /// Returns the descriptions of the clocks of edge and cloud for live updates.
    pub(super) fn describe_clocks(&self) -> (HostClock, HostClock) {
        (describe_clock(self.edge.announcement()), describe_clock(self.cloud.announcement()))
    }

    /// Adds an exchange to the relation by `learn`. Returns whether the relation accepted the exchange.
    fn learn(
        &mut self,
        learn: fn(&mut Relation, &ExchangeObservation) -> LearnResult,
        observation: &ExchangeObservation,
        now: Stamp,
        changes: &mut ClockStateChanges,
    ) -> bool {
        let learn_result =
            self.update_relation(epochs_of(observation), |relation| learn(relation, observation));
        self.handle_learn_result(learn_result, observation, now, changes);
        !matches!(learn_result, LearnResult::Refused(_))
    }

    /// Updates the relation with information from these epochs of the related clocks of edge and cloud. If the relation
    /// restarts, the relation period becomes void. A new epoch shows whose clock was stepped.
    fn update_relation<T>(
        &mut self,
        (edge, cloud): (u32, Option<u32>),
        update: impl FnOnce(&mut Relation) -> T,
    ) -> T {
        let restarts_before = self.relation.exchange_counts().restarts;
        let result = update(&mut self.relation);
        let has_new_edge_epoch = self.edge.begin_epoch(edge);
        // 0 stands for an unknown epoch, because it is never newer than the latest known epoch.
        let has_new_cloud_epoch = self.cloud.begin_epoch(cloud.unwrap_or(0));
        let is_restarted = self.relation.exchange_counts().restarts > restarts_before;
        if is_restarted {
            self.period.make_void();
            // The time of a step that no host reported is not known. The exchanges of this second may be from after the
            // step although they did not show it, so they must not bound the offset before the step.
            if !has_new_edge_epoch && !has_new_cloud_epoch {
                self.current_second.remove_exchanges();
            }
        }
        self.reports.record_steps(is_restarted, (has_new_edge_epoch, has_new_cloud_epoch));
        result
    }

    /// Reports what the relation learned from an exchange, and adds the exchange to the current second unless the
    /// relation refused or ignored it.
    fn handle_learn_result(
        &mut self,
        learn_result: LearnResult,
        observation: &ExchangeObservation,
        now: Stamp,
        changes: &mut ClockStateChanges,
    ) {
        self.replace_void_period(now, changes);
        let settings = *self.relation.settings();
        match learn_result {
            LearnResult::Refused(_) | LearnResult::Ignored => return,
            LearnResult::Accepted => {}
            LearnResult::Restarted(movement) => {
                let limit = |violation| match violation {
                    ViolatedLimit::Drift => settings.max_drift_ppm,
                    ViolatedLimit::DriftChange => settings.max_drift_change_ppm_per_s,
                };
                let violation = self.relation.violated_limit().map(|violation| (violation, limit(violation)));
                // One update reports one restart at most: the latest report replaces an earlier one.
                changes.restart = self.reports.report_restart(movement, violation).or(changes.restart.take());
            }
            LearnResult::Jumped(movement) => {
                let jump = self.reports.report_jump(movement, observation.exchange.returned);
                changes.jump = jump.or(changes.jump.take());
            }
        }
        let proven_skew = self.relation.excess_skew();
        let excess_skew = proven_skew.map(|proven| ExcessSkew { proven, limit_ppm: settings.max_drift_ppm });
        changes.excess_skew = self.reports.report_excess_skew(excess_skew).or(changes.excess_skew.take());
        self.current_second.add_exchange(&observation.exchange, settings.max_drift_ppm);
    }

    /// Starts a new relation period if a step has made the current period void. The current second is then closed
    /// without an offset, because its exchanges preceded the step.
    fn replace_void_period(&mut self, now: Stamp, changes: &mut ClockStateChanges) {
        if self.period.is_void() {
            let is_current = now.wall.unix_seconds() == self.current_second.start_s;
            let at = if is_current { now } else { edge_time(now, self.current_second.end()) };
            self.close_second(at, None, now.wall, changes);
            self.period = RelationPeriod::new();
        }
    }

    /// Closes the current second with the state of the clocks at `at`, the end of the second. Starts the second that
    /// contains `now`.
    fn close_second(
        &mut self,
        at: Stamp,
        offset: Option<&Offset>,
        now: WallTime,
        changes: &mut ClockStateChanges,
    ) {
        if !self.current_second.is_empty() {
            let networks: BTreeSet<&NetworkName> =
                self.networks.names().chain(self.current_second.networks()).collect();
            let sample = |network| self.sample(network, at, offset.cloned());
            let samples: Vec<ClockSample> = networks.into_iter().map(sample).collect();
            changes.samples.extend_from_slice(&samples);
            // Live updates show the last complete second.
            self.period.set_last_second(samples);
        }
        self.networks.close_second();
        self.current_second = LinkSecond::new(now.unix_seconds());
    }

    /// Returns the sample of a network for the current second, with the state at `at`.
    fn sample(&self, network: &NetworkName, at: Stamp, offset: Option<Offset>) -> ClockSample {
        let settings = self.relation.settings();
        let basis = EstimateBasis {
            clocks: settings.clocks,
            at_raw: Some(at.raw),
            max_drift_change_ppm_per_s: settings
                .clocks
                .are_free_running()
                .then_some(settings.max_drift_change_ppm_per_s),
            proven_skew_ppm: self.relation.proven_skew().map(ProvenSkew::ordered_ppm),
            // The age is stored only if an exchange from before the window bounds the offset.
            oldest_exchange_age: self.relation.window_span(at.raw).filter(|span| *span > settings.window),
            claims_trusted: settings.trust_time_daemons,
            probes_authenticated: self.current_second.authenticated,
        };
        ClockSample {
            peer: self.peer,
            peer_name: self.peer_name.clone(),
            at: at.wall,
            relation_period: self.period.id(),
            max_drift_ppm: settings.max_drift_ppm,
            upper: self.current_second.upper,
            lower: self.current_second.lower,
            offset,
            probes: self.current_second.probes,
            exchanges: self.relation.exchange_counts(),
            round_trip: self.current_second.round_trips(),
            up: self.current_second.delays(network, Direction::Up),
            down: self.current_second.delays(network, Direction::Down),
            network: network.clone(),
            basis: Some(basis),
        }
    }

    /// Passes the current claims of the time daemons to the relation.
    fn update_claims(&mut self, now: RawTime) {
        let limit = self.relation.settings().max_drift_ppm;
        self.relation.set_claims(self.edge.claim(now, limit), self.cloud.claim(now, limit), now);
    }
}

/// Returns whether a stamp is of the latest known epoch of its clock.
fn is_current(stamp: &HostStamp, clock: &AnnouncedClock) -> bool {
    stamp.epoch == Some(clock.epoch())
}

/// Returns the readings of the edge's clocks at the wall-clock time `at`, which is shortly before `now`.
fn edge_time(now: Stamp, at: WallTime) -> Stamp {
    let elapsed = (now.wall - at).max(Span::ZERO).min(MAX_OVERDUE);
    Stamp { wall: at, raw: now.raw - elapsed, ..now }
}

/// Returns the epochs of edge and cloud in an exchange. An exchange may arrive before the announcement of a new epoch.
const fn epochs_of(observation: &ExchangeObservation) -> (u32, Option<u32>) {
    (observation.edge_epoch, observation.cloud_epoch)
}

#[cfg(test)]
mod tests;
