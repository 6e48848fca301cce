//! The task that queries the peer for the stamps of observed pairs. It owns the connection to the peer.

use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use peernet_clock::{LogThrottle, MonoTime, OneWayDelay, Span};
use peernet_networks::CloseReason;
use peernet_stream::IncidentKind;
use tokio::sync::mpsc;

use super::connection::{PeerConnection, PeerConnector};
use super::pending::{PeerAnswer, PendingPairs};
use super::reception::{ReceptionReport, ReceptionWatch};
use super::{Pair, SettledPair, record_without_peer};
use crate::host::Host;
use crate::link::TransitStamps;
use crate::observed::MAX_KEYS;
use crate::pipeline::observe::record;
use crate::pipeline::peer_problem::PeerProblem;
use crate::reconnect_backoff::ReconnectBackoff;

/// The task of one pipeline. It ends when the observer closes its channel.
pub(super) struct PeerTask {
    connector: Arc<PeerConnector>,
    /// The connection, if one is open.
    connection: Option<Arc<PeerConnection>>,
    /// Pairs for which the observer wants the peer's stamps, each with its key.
    queries: mpsc::Receiver<(i64, Pair)>,
    settled_sender: mpsc::Sender<SettledPair>,
    pending: PendingPairs<Pair>,
    reception: ReceptionWatch,
    throttle: LogThrottle,
}

/// Result of a wait.
enum WaitResult<T> {
    /// The awaited future is ready.
    Ready(T),
    /// A pair was added, or a pair has expired.
    PairsChanged,
    /// The observer has closed its channel.
    ChannelClosed,
}

impl PeerTask {
    pub(super) fn new(
        connector: PeerConnector,
        queries: mpsc::Receiver<(i64, Pair)>,
        settled_sender: mpsc::Sender<SettledPair>,
    ) -> Self {
        let pending = PendingPairs::new(Span::from(connector.answer_timeout()));
        let (reception, throttle) = (ReceptionWatch::default(), LogThrottle::default());
        Self {
            connector: Arc::new(connector),
            connection: None,
            queries,
            settled_sender,
            pending,
            reception,
            throttle,
        }
    }

    /// Queries the peer until the observer closes its channel. A lost connection is reopened.
    pub(super) async fn run(mut self, first_connection: PeerConnection) {
        let mut reconnect_backoff = ReconnectBackoff::new(self.connector.host().id);
        let mut next_connection = Some(first_connection);
        while let Some(connection) = next_connection.map(Arc::new) {
            self.connection = Some(Arc::clone(&connection));
            let connected_at = self.now();
            let Some(reason) = self.query_through(&connection).await else {
                self.abandon();
                // Dropping the channels lets the observer continue, so that the observer need not wait for the goodbye.
                drop(self);
                connection.close().await;
                return;
            };
            self.connection = None;
            self.reception.record_disconnect();
            let name = &connection.name;
            let text = format!(
                "lost the connection to {name}: {reason}; until the connection is reopened, iterations are recorded \
                 without the peer's stamps (peer-unanswered)"
            );
            self.connector.report(IncidentKind::Disconnected, Some(connection.host), text);
            drop(connection);
            let pause = reconnect_backoff.pause_after_connection(self.now() - connected_at);
            next_connection = self.reconnect(pause, &mut reconnect_backoff).await;
        }
        self.abandon();
    }

    /// Queries the peer through one connection. Returns the reason for its end, or `None` if the observer has closed
    /// its channel.
    async fn query_through(&mut self, connection: &PeerConnection) -> Option<CloseReason> {
        let connector = Arc::clone(&self.connector);
        let mut closed = pin!(connection.closed());
        loop {
            self.expire();
            let keys = self.pending.take_due(self.now(), MAX_KEYS);
            if !keys.is_empty() {
                match self.wait_for(connection.query(keys)).await? {
                    // A faulty peer may answer with more pairs than were requested. Pairs beyond the maximum number of
                    // keys in a request are ignored.
                    Ok(answer) => answer.pairs.iter().take(MAX_KEYS).for_each(|stamps| {
                        self.take_answer(&PeerAnswer { peer: connection.host, stamps: *stamps });
                    }),
                    Err(problem) => self.log_failed_query(problem.text()),
                }
                continue;
            }
            let due = self.pending.next_due();
            let idle = async {
                tokio::select! {
                    reason = &mut closed => Some(reason),
                    () = connector.sleep_until(due) => None,
                }
            };
            match self.wait(idle).await {
                WaitResult::Ready(Some(reason)) => return Some(reason),
                WaitResult::Ready(None) | WaitResult::PairsChanged => {}
                WaitResult::ChannelClosed => return None,
            }
        }
    }

    /// Reopens the connection after a pause, and retries until that succeeds. Returns `None` if the observer has closed
    /// its channel.
    async fn reconnect(
        &mut self,
        mut pause: Duration,
        reconnect_backoff: &mut ReconnectBackoff,
    ) -> Option<PeerConnection> {
        let connector = Arc::clone(&self.connector);
        // The loss of the connection has been reported already.
        let mut reported_problem = Some(PeerProblem::Unreachable(String::new()));
        loop {
            self.wait_for(tokio::time::sleep(pause)).await?;
            let problem = match self.wait_for(connector.open()).await? {
                Ok(connection) => return Some(connection),
                Err(problem) => problem,
            };
            pause = problem.pause(reconnect_backoff);
            if !problem.is_covered_by(reported_problem.as_ref()) {
                let unknown_peer = None;
                connector.report(problem.kind(), unknown_peer, problem.describe());
                reported_problem = Some(problem);
            }
        }
    }

    /// Waits for a future while pairs are added and expire. Returns `None` if the observer has closed its channel.
    async fn wait_for<T>(&mut self, future: impl Future<Output = T>) -> Option<T> {
        let mut future = pin!(future);
        loop {
            self.expire();
            match self.wait(future.as_mut()).await {
                WaitResult::Ready(output) => return Some(output),
                WaitResult::PairsChanged => {}
                WaitResult::ChannelClosed => return None,
            }
        }
    }

    /// Waits until a future is ready, a pair is added or expires, or the observer closes its channel.
    async fn wait<T>(&mut self, future: impl Future<Output = T>) -> WaitResult<T> {
        let connector = Arc::clone(&self.connector);
        let expiry = self.pending.next_expiry();
        tokio::select! {
            output = future => WaitResult::Ready(output),
            query = self.queries.recv() => match query {
                Some((key, pair)) => {
                    self.pending.add(key, pair, self.now());
                    WaitResult::PairsChanged
                }
                None => WaitResult::ChannelClosed,
            },
            () = connector.sleep_until(expiry) => WaitResult::PairsChanged,
        }
    }

    /// Records the pairs that an answer of the peer completes.
    fn take_answer(&mut self, answer: &PeerAnswer) {
        let has_both_messages = true;
        for pair in self.pending.take_answer(answer) {
            self.record_reception(has_both_messages);
            self.settle_with(&pair, answer);
        }
    }

    /// Records the pairs whose timeout has passed.
    fn expire(&mut self) {
        let now = self.now();
        while let Some((pair, answer)) = self.pending.expire(now) {
            self.settle_incomplete(&pair, answer.as_ref());
        }
    }

    /// Records all waiting pairs.
    fn abandon(&mut self) {
        while let Ok((key, pair)) = self.queries.try_recv() {
            self.pending.add(key, pair, self.now());
        }
        while let Some((pair, answer)) = self.pending.abandon() {
            self.settle_incomplete(&pair, answer.as_ref());
        }
    }

    /// Records a pair for which the peer has not sent all stamps.
    fn settle_incomplete(&mut self, pair: &Pair, answer: Option<&PeerAnswer>) {
        match answer {
            Some(answer) => {
                let has_both_messages = false;
                self.record_reception(has_both_messages);
                self.settle_with(pair, answer);
            }
            // Without an answer it is unknown whether the peer received the messages, so it is not recorded.
            None => self.settle(record_without_peer(self.connector.host(), pair)),
        }
    }

    /// Records a pair with the peer's stamps.
    fn settle_with(&self, pair: &Pair, answer: &PeerAnswer) {
        // A delay needs the clock relation, which belongs to a connection to this peer. Without a connection the stamps
        // are recorded without delays.
        let connection = self.connection.as_ref().filter(|connection| connection.host == answer.peer);
        let judge = |up: &TransitStamps, down: Option<&TransitStamps>| {
            connection.map_or([None, None], |connection| connection.judge(up, down))
        };
        self.settle(record_with_peer(self.connector.host(), pair, answer, judge));
    }

    /// Passes a recorded pair to the observer.
    fn settle(&self, settled_pair: SettledPair) {
        // The channel has capacity for all waiting pairs (`MAX_PENDING`), so sending fails only if the pipeline has
        // ended.
        if self.settled_sender.try_send(settled_pair).is_err() {
            tracing::debug!("an observed iteration was dropped: its pipeline has ended");
        }
    }

    /// Records whether the peer received both messages of a pair, and reports a change. Nothing is reported without a
    /// connection.
    fn record_reception(&mut self, has_both: bool) {
        let Some(connection) = &self.connection else { return };
        let (name, peer) = (connection.name.to_string(), connection.host);
        let Some(report) = self.reception.record(has_both, self.connector.host().clock.mono()) else {
            return;
        };
        let peer_pipeline = self.connector.peer_pipeline();
        let (kind, text) = match report {
            ReceptionReport::Stopped => (
                IncidentKind::Disconnected,
                format!(
                    "{name} received none of the pairs of messages of the last 10 s; check on its page that its pipeline \
                     {peer_pipeline} runs and observes the same topics, and that the nodes copy the field by which messages are paired"
                ),
            ),
            ReceptionReport::Resumed => (
                IncidentKind::Connected,
                format!("{name} receives the same messages with its pipeline {peer_pipeline} again"),
            ),
        };
        self.connector.report(kind, Some(peer), text);
    }

    /// Logs why a query failed. The query is repeated.
    fn log_failed_query(&mut self, problem: &str) {
        let now = self.now();
        if let Some(times) = self.throttle.count_event("failed query", None, now) {
            tracing::warn!(
                times,
                "{problem}; iterations whose stamps do not arrive in time count as peer-unanswered"
            );
        }
    }

    fn now(&self) -> MonoTime {
        self.connector.host().clock.mono()
    }
}

fn record_with_peer(
    host: &Host,
    pair: &Pair,
    answer: &PeerAnswer,
    judge: impl FnOnce(&TransitStamps, Option<&TransitStamps>) -> [Option<OneWayDelay>; 2],
) -> SettledPair {
    let (tree, ended) =
        record::tree_with_peer_stamps((&host.clock, host.id), answer.peer, pair, &answer.stamps, judge);
    SettledPair { position: pair.input.position, tree, ended }
}
