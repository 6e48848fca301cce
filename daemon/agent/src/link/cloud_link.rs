//! The link between this host and a cloud.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use peernet_clock::{
    ClockIdentity, Direction, ExchangeObservation, MonoTime, OneWayDelay, RelatedClocks, Relation,
    RelationSettings, Span, Stamp,
};
use peernet_logger::{HostId, Measure, NodeId, Recorder, Slug, Tree};
use peernet_networks::{CompletedRequest, PeerClock, SessionAccepted};
use peernet_probes::ProbeResult;
use peernet_stream::{Event, IncidentKind, LinkLive, NetworkName, Probing};
use tokio::sync::watch;

use super::clock_state::{ClockStateChanges, LinkClockState, MessageDelay};
use super::connections::Connections;
use super::correction::{correct, sent_bits};
use super::incident_texts::{excess_text, jump_text, lost_proof_text, restart_text, wall_set_text};
use super::named_reflector::NamedReflector;
use super::probe_pace::ProbePace;
use super::shared::{Session, SharedLinkState, lock};
use super::transit_stamps::TransitStamps;
use crate::incidents::IncidentSubject;
use crate::same_clock::NotProven;

/// Longest wait of a session for the proof that both ends read one clock. A cloud on this machine answers within a
/// millisecond.
const FIRST_PROOF_TIMEOUT: Duration = Duration::from_millis(500);

/// The link to one cloud, over all networks.
// Locks are held for microseconds, never across a wait. Only live updates take the lock of the connections.
#[derive(Debug)]
pub(crate) struct CloudLink {
    pub(super) shared: Arc<SharedLinkState>,
    pub(super) cloud: LinkedCloud,
    /// `true` if it is proven that both processes read one clock; `None` until the first attempt has ended.
    same_clock: watch::Sender<Option<bool>>,
    /// Sessions with the cloud, oldest first; empty when the link has ended.
    pub(super) sessions: watch::Sender<Vec<Session>>,
    pub(super) pace: ProbePace,
    clock_state: Mutex<LinkClockState>,
    pub(super) probing: Mutex<Probing>,
    /// Reflector that the configuration names for the cloud.
    reflector: Option<NamedReflector>,
    connections: Mutex<Connections>,
}

/// The cloud of a link.
#[derive(Debug)]
pub(super) struct LinkedCloud {
    pub(super) id: HostId,
    pub(super) name: Slug,
    /// Identity of the cloud's clock.
    pub(super) clock: ClockIdentity,
    /// Kind of the clocks that the relation relates.
    pub(super) clocks: RelatedClocks,
}

impl CloudLink {
    pub(super) fn new(
        shared: &Arc<SharedLinkState>,
        accepted: &SessionAccepted,
        clocks: RelatedClocks,
    ) -> Self {
        let clock = &shared.host.clock;
        let now = clock.stamp();
        let settings = RelationSettings { clocks, ..shared.relation };
        let relation = Relation::new(settings);
        let announcements = (shared.host.host_clock.borrow().clone(), accepted.host_clock.clone());
        let mut clock_state =
            LinkClockState::new((accepted.host, accepted.name.clone()), relation, announcements, now);
        // The latest announcement about this host's clocks may be older than the latest interruption.
        clock_state.begin_epoch_of_edge(clock.epoch());
        let reflector_address = shared.probes.reflectors.get(&accepted.name);
        let reflector =
            reflector_address.map(|address| NamedReflector::new(address.clone(), shared.relation));
        let link = Self {
            shared: Arc::clone(shared),
            cloud: LinkedCloud {
                id: accepted.host,
                name: accepted.name.clone(),
                clock: accepted.clock.clone(),
                clocks,
            },
            same_clock: watch::Sender::new(None),
            sessions: watch::Sender::new(Vec::new()),
            pace: ProbePace::new(now.mono),
            clock_state: Mutex::new(clock_state),
            probing: Mutex::new(Probing::Off("not started yet".to_owned())),
            reflector,
            connections: Mutex::default(),
        };
        link.adjust_pace(now.mono);
        link
    }

    /// Judges the delays of an answered request over a network and sets them in its tree. Returns the sum of both
    /// delays by the hosts' monotonic clocks. The sum is known even if a wall clock was stepped in the meantime.
    pub(super) fn correct(&self, network: &NetworkName, completed: &mut CompletedRequest) -> Option<Span> {
        let (Some(up), Some(down), Some(arrived)) =
            (completed.upload, completed.download, completed.arrived_at)
        else {
            // Without an answer neither delay is known.
            return None;
        };
        let sum_of_delays = sum_of_delays(&completed.recorder, up, down, arrived);
        let tree = completed.recorder.tree_mut();
        let bits = Direction::ALL.map(|direction| sent_bits(tree, direction));
        let message_delays = [
            MessageDelay { raw: raw_difference(tree, up)?, bits: bits[0] },
            MessageDelay { raw: raw_difference(tree, down)?, bits: bits[1] },
        ];
        let ([up_delay, down_delay], changes) =
            self.judge(network, completed.observation.as_ref(), message_delays, arrived);
        correct(tree, up, Direction::Up, up_delay);
        correct(tree, down, Direction::Down, down_delay);
        if let Some(first_partial_answer) = completed.first_partial_answer {
            self.correct_first_partial_answer(tree, first_partial_answer, completed.observation.as_ref());
        }
        self.report(changes);
        sum_of_delays
    }

    /// Judges the delay of the first partial answer and sets it in the tree.
    fn correct_first_partial_answer(
        &self,
        tree: &mut Tree,
        first_partial_answer: NodeId,
        observation: Option<&ExchangeObservation>,
    ) {
        let epochs = observation.map(|observation| (observation.cloud_epoch, Some(observation.edge_epoch)));
        let stamps = TransitStamps::in_tree(tree, first_partial_answer, epochs.unwrap_or_default());
        let Some(stamps) = stamps else { return };
        let delay = lock(&self.clock_state).judge_partial_answer(&stamps);
        if let Some(Measure::Transit(transit)) = tree.measure_mut(first_partial_answer) {
            transit.delay = Some(delay);
        }
    }

    /// Judges an exchange whose answer arrived at `arrived`. `observation` is `None` if a host reports that its clock was
    /// stepped during the exchange.
    fn judge(
        &self,
        network: &NetworkName,
        observation: Option<&ExchangeObservation>,
        message_delays: [MessageDelay; 2],
        arrived: Stamp,
    ) -> ([OneWayDelay; 2], ClockStateChanges) {
        self.pace.record_data(arrived.mono);
        self.adjust_pace(arrived.mono);
        self.update_clock_state(|clock_state, now| match observation {
            Some(observation) => clock_state.judge(network, observation, message_delays, now),
            None => clock_state.judge_interrupted(network, message_delays, now),
        })
    }

    /// Updates the clock state at the present time.
    // The clock is read under the lock, so that the times of the updates are in the order of the updates. An update at an
    // earlier time than the previous update looks like a wall clock that was set back: it closes the current second early,
    // and opens a closed second again.
    fn update_clock_state<T>(&self, update: impl FnOnce(&mut LinkClockState, Stamp) -> T) -> T {
        let mut clock_state = lock(&self.clock_state);
        update(&mut clock_state, self.shared.host.clock.stamp())
    }

    /// Judges the delays of observed messages, one in each direction. The relation does not learn from these delays.
    pub(crate) fn judge_stamps(
        &self,
        up: &TransitStamps,
        down: Option<&TransitStamps>,
    ) -> [Option<OneWayDelay>; 2] {
        lock(&self.clock_state).judge_stamps(up, down)
    }

    /// Handles the result of a probe.
    pub(super) fn handle_probe_result(&self, result: &ProbeResult, authenticated: bool) {
        let changes = self.update_clock_state(|clock_state, now| {
            clock_state.handle_probe_result(result, authenticated, now)
        });
        self.report(changes);
    }

    /// Closes the current second if its time has passed.
    pub(super) fn advance_second(&self) {
        self.adjust_pace(self.shared.host.clock.mono());
        let changes = self.update_clock_state(LinkClockState::advance_second);
        self.report(changes);
    }

    /// Closes the current second at the end of the link.
    pub(super) fn finish(&self) {
        let changes = self.update_clock_state(LinkClockState::finish);
        self.report(changes);
    }

    /// Handles an announcement about this host's clocks.
    pub(super) fn handle_edge_announcement(&self, clock: PeerClock) {
        let now = self.shared.host.clock.raw();
        lock(&self.clock_state).handle_edge_announcement(clock, now);
    }

    /// Handles an announcement of the cloud about its clocks.
    pub(super) fn handle_cloud_announcement(&self, clock: PeerClock) {
        let now = self.shared.host.clock.raw();
        let changes = lock(&self.clock_state).handle_cloud_announcement(clock, now);
        self.report(changes);
    }

    /// Handles the result of an attempt to prove that both processes read one clock.
    pub(super) fn set_same_clock(&self, proof: Result<(), NotProven>) {
        let is_proven = proof.is_ok();
        let now = self.shared.host.clock.stamp();
        // Only a proof that was given before can be lost.
        let was_proven = *self.same_clock.borrow() == Some(true);
        let mut changes = ClockStateChanges::default();
        match proof {
            Ok(()) => {
                lock(&self.clock_state).confirm_same_clock();
                if !was_proven {
                    tracing::info!(peer = %self.cloud.name, "both processes read the same clock; delays are exact");
                }
            }
            Err(reason) if was_proven => {
                tracing::debug!(peer = %self.cloud.name, "delays are estimated by exchanges from now on: {reason}");
                changes = lock(&self.clock_state).handle_lost_proof(reason, now.raw);
            }
            Err(reason) => {
                lock(&self.clock_state).reject_same_clock();
                tracing::debug!(peer = %self.cloud.name, "delays are estimated by exchanges: {reason}");
            }
        }
        // The result is sent after the clock state was updated, because a receiver may have a delay judged at once.
        self.same_clock.send_replace(Some(is_proven));
        self.adjust_pace(now.mono);
        self.report(changes);
    }

    /// Waits until it is known whether both processes read one clock, at most [`FIRST_PROOF_TIMEOUT`].
    pub(crate) async fn wait_for_first_proof(&self) {
        let mut same_clock = self.same_clock.subscribe();
        let first_result = same_clock.wait_for(Option::is_some);
        if tokio::time::timeout(FIRST_PROOF_TIMEOUT, first_result).await.is_err() {
            tracing::debug!(peer = %self.cloud.name, "no answer yet whether both processes read the same clock");
        }
    }

    /// Returns whether it is proven that both processes read one clock.
    fn is_same_clock(&self) -> bool {
        *self.same_clock.borrow() == Some(true)
    }

    /// Returns the cloud's name.
    pub(crate) const fn name(&self) -> &Slug {
        &self.cloud.name
    }

    /// Probes the reflector that the configuration names for the cloud, if there is one, as long as the future is
    /// polled.
    pub(super) async fn probe_named_reflector(&self) -> Infallible {
        match &self.reflector {
            Some(reflector) => reflector.probe(&self.shared, &self.cloud.name, &self.pace).await,
            None => std::future::pending().await,
        }
    }

    /// Records that a session was opened.
    pub(super) fn join(&self, session: Session) {
        lock(&self.clock_state).join(&session.network);
        self.sessions.send_modify(|sessions| sessions.push(session));
    }

    /// Records that a session has ended. Returns whether the link has no session any more.
    pub(super) fn leave(&self, id: u64, network: &NetworkName) -> bool {
        lock(&self.clock_state).leave(network);
        self.sessions.send_modify(|sessions| sessions.retain(|session| session.id != id));
        self.sessions.borrow().is_empty()
    }

    /// Records that the session that sent the probes has ended and that all probes of that session are counted.
    pub(super) fn settle_sessions(&self) {
        let changes = self.update_clock_state(LinkClockState::settle_sessions);
        self.report(changes);
    }

    /// Returns the live state: a link for each network in use.
    pub(super) fn live(&self) -> Vec<LinkLive> {
        // The list is cloned, so that sessions can join while the statistics are read.
        let sessions = self.sessions.borrow().clone();
        let mut networks: BTreeMap<NetworkName, Vec<Slug>> = BTreeMap::new();
        for session in &sessions {
            networks.entry(session.network.clone()).or_default().push(session.pipeline.clone());
        }
        let mut probing = lock(&self.probing).clone();
        if let Probing::On { rate_hz, .. } = &mut probing {
            *rate_hz = self.pace.rate_hz();
        }
        let clock = &self.shared.host.clock;
        let connections = lock(&self.connections).read_for(&sessions, clock.mono());
        let now = clock.stamp();
        let rate_hz = self.pace.rate_hz();
        let reflector =
            self.reflector.as_ref().map(|reflector| reflector.live(rate_hz, now, clock.wall_ahead()));
        let clock_state = lock(&self.clock_state);
        let (edge, cloud) = clock_state.describe_clocks();
        let link = |(network, mut pipelines): (NetworkName, Vec<Slug>)| {
            pipelines.sort_unstable();
            LinkLive {
                peer: self.cloud.id,
                peer_name: self.cloud.name.clone(),
                networks: vec![network.to_string()],
                pipelines,
                same_clock: self.is_same_clock(),
                probing: probing.clone(),
                edge: Some(edge.clone()),
                cloud: Some(cloud.clone()),
                latest_sample: clock_state.latest_sample(&network, now),
                connections: connections
                    .iter()
                    .filter(|connection| connection.network == network)
                    .cloned()
                    .collect(),
                reflector: reflector.clone(),
            }
        };
        networks.into_iter().map(link).collect()
    }

    /// Sets the rate of the probes by the traffic of the link.
    fn adjust_pace(&self, now: MonoTime) {
        self.pace.adjust(&self.shared.probes, self.is_same_clock(), now);
    }

    /// Queues the samples of closed seconds, and reports steps, jumps and violated assumptions as incidents.
    fn report(&self, changes: ClockStateChanges) {
        let host = &self.shared.host;
        for sample in changes.samples {
            host.event_queue.push_event(None, Event::Clock(Box::new(sample)));
        }
        let (edge, cloud) = (&host.name, &self.cloud.name);
        let texts = [
            changes.restart.map(|restart| restart_text(restart, edge, cloud)),
            changes.jump.map(|jump| jump_text(jump, edge, cloud)),
            changes.is_cloud_wall_set.then(|| wall_set_text(cloud)),
            changes.excess_skew.map(|excess_skew| excess_text(excess_skew, edge, cloud)),
            changes.lost_proof.map(|lost_proof| lost_proof_text(&lost_proof, edge, cloud)),
        ];
        for text in texts.into_iter().flatten() {
            let subject = IncidentSubject { peer: Some(self.cloud.id), ..IncidentSubject::default() };
            host.incidents.report(IncidentKind::ClockStep, subject, text);
        }
    }
}

/// Returns the receiver's stamp minus the sender's; `None` if the message has not arrived.
fn raw_difference(tree: &Tree, transit: NodeId) -> Option<Span> {
    match &tree.get(transit)?.measure {
        Measure::Transit(transit) => Some(transit.received? - transit.sent),
        _ => None,
    }
}

/// Returns the sum of the delays of both directions: the edge's waiting time minus the time on the cloud, each by the
/// monotonic clock of its host.
fn sum_of_delays(recorder: &Recorder, up: NodeId, down: NodeId, arrived: Stamp) -> Option<Span> {
    let tree = recorder.tree();
    let waiting_time = recorder.offset(arrived.mono) - tree.get(up)?.start;
    // The starts of the cloud's nodes count from the arrival of the message. A negative result means that the cloud's
    // times are wrong.
    Some(waiting_time - tree.get(down)?.start).filter(|span| !span.is_negative())
}

#[cfg(test)]
mod tests;
