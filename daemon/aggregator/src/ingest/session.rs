//! Decides how to handle each frame and each host. Does no I/O: frames are the input; replies and live events are the
//! output.

mod admission;
mod output;
mod store_view;

use bytes::Bytes;
use peernet_clock::{LogThrottle, MonoTime, Span, Stamp};
use peernet_logger::{HostId, RunId};
use peernet_networks::{ConnectionId, Peer};
use peernet_stream::{Arrival, BatchHead, Challenges, LiveUpdate, Receiving, ToAgent, ToAggregator, codec};

pub(crate) use self::output::RejectedCounts;
use self::output::SessionOutput;
use self::store_view::StoreView;
use super::committing::StoreEvent;
use super::hosts::{Hosts, Newcomer};
use super::queue::{AdmittedWork, Queue};
use super::routes::{Admission, Routes};
use crate::live::LiveEvent;
use peernet_store::writing::{CommitResult, LiveRunDescription, StoredState, Streams, UnstorableBatch, Work};

/// Time without messages after which a host loses its session and has to send its hello again.
const SESSION_TIMEOUT: Span = Span::from_seconds(60);
/// Time without messages after which a newcomer is dropped. Agents send four messages a second.
const NEWCOMER_TIMEOUT: Span = Span::from_seconds(10);
/// Usual size of an agent's batch, bytes. The queue's capacity in batches is computed with this size.
const USUAL_BATCH_BYTES: usize = 128 * 1024;

/// The state of ingest: the hosts, their connections and sessions, and the queue.
#[derive(Debug)]
pub(crate) struct IngestSession {
    receiving: Receiving,
    challenges: Challenges<ConnectionId>,
    hosts: Hosts,
    queue: Queue,
    routes: Routes,
    store: StoreView,
    refusals: LogThrottle,
    output: SessionOutput,
}

impl IngestSession {
    /// Creates the state without sessions. `hosts` and `streams` come from the database; `runs_without_start` are runs
    /// of which the database has iterations only.
    pub(crate) fn new(
        receiving: Receiving,
        challenges: Challenges<ConnectionId>,
        hosts: Hosts,
        queue: Queue,
        streams: Streams,
        runs_without_start: Vec<(HostId, RunId)>,
    ) -> Self {
        Self {
            receiving,
            challenges,
            hosts,
            queue,
            routes: Routes::default(),
            store: StoreView::new(streams, runs_without_start),
            refusals: LogThrottle::default(),
            output: SessionOutput::default(),
        }
    }

    /// Processes a frame of a connection.
    pub(super) fn handle_frame(&mut self, from: &Peer, frame: &Bytes, now: Stamp) {
        // The first bytes of a frame show its kind, so that batches are not decoded twice. A batch may arrive in parts:
        // `handle_part` returns the frame of the batch when all parts have arrived.
        if let Some(part) = codec::decode_part(frame) {
            if self.has_session(from, part.host)
                && let Some(frame) = self.receiving.handle_part(&part, now.mono)
                && let Some(head) = codec::decode_batch_head(&frame)
            {
                self.handle_batch(from, head, &frame, now);
            }
            return;
        }
        if let Some(head) = codec::decode_batch_head(frame) {
            self.handle_batch(from, head, frame, now);
            return;
        }
        match codec::decode(frame) {
            Ok(ToAggregator::Hello(hello)) => self.handle_hello(from, hello, now),
            Ok(ToAggregator::Proof(proof)) => self.handle_proof(from, proof, now),
            Ok(ToAggregator::Live(update)) => {
                // `handle_live` returns an answer only for a host without a session.
                if self.has_session(from, update.host)
                    && self.receiving.handle_live(update.host, now.mono).is_none()
                {
                    self.describe_runs(&update, now.mono);
                    self.output.announce(LiveEvent::Update(Box::new(update)));
                }
            }
            Ok(ToAggregator::Echo { host, bytes }) => {
                if self.has_session(from, host) {
                    self.output.reply(from.connection, self.receiving.handle_echo(host, bytes, now.mono));
                }
            }
            Ok(ToAggregator::Goodbye(host)) => {
                // Nothing of a newcomer is stored, so nothing remains to be done after dropping a newcomer.
                if self.has_session(from, host) && !self.forget_newcomer(host) {
                    self.receiving.handle_goodbye(host);
                    self.routes.remove(host);
                    // If the queue is full, the next hello of the host ends its runs.
                    if let Some(slot) = self.queue.reserve(0) {
                        slot.fill(AdmittedWork::Work(Work::Goodbye(host)), now.mono);
                    }
                    self.output.announce(LiveEvent::Goodbye(host));
                }
            }
            Err(_) => {
                self.output.count_unreadable_frame();
            }
        }
    }

    /// Stores the pipelines and placements of runs whose start is not in this database: the start was acknowledged while
    /// another database was in use, so the agent does not send it again. Live updates contain the pipeline and the
    /// placement.
    fn describe_runs(&mut self, update: &LiveUpdate, now: MonoTime) {
        if !self.store.has_runs_without_start() {
            return;
        }
        for live in &update.pipelines {
            let Some(run) = live.run.filter(|run| self.store.is_without_start(update.host, *run)) else {
                continue;
            };
            // If the queue is full, a later update is used.
            let Some(slot) = self.queue.reserve(0) else { return };
            let (host, pipeline, placement) = (update.host, live.pipeline.clone(), live.placement.clone());
            let description = LiveRunDescription { host, run, pipeline, placement };
            slot.fill(AdmittedWork::Work(Work::LiveDescription(Box::new(description))), now);
            self.store.record_description(update.host, run);
        }
    }

    /// Returns whether the host has a session on the connection. If not, the agent is asked for its hello.
    fn has_session(&mut self, from: &Peer, host: HostId) -> bool {
        let has_session = self.routes.connection_of(host) == Some(from.connection);
        if !has_session {
            self.output.reject_stranger(from.connection);
        }
        has_session
    }

    /// Handles the end of a connection. Its stored hosts send their hello on the next connection; its newcomers are
    /// dropped.
    pub(super) fn handle_connection_closed(&mut self, connection: ConnectionId) {
        self.challenges.forget(&connection);
        let routes = &self.routes;
        for host in self.hosts.select_newcomers(|host| routes.connection_of(host) == Some(connection)) {
            self.forget_newcomer(host);
        }
    }

    /// Admits a batch to the queue, or requests it again if the queue is full.
    fn handle_batch(&mut self, from: &Peer, head: BatchHead, frame: &Bytes, now: Stamp) {
        if !self.has_session(from, head.host) {
            return;
        }
        if self.hosts.is_newcomer(head.host) && self.hosts.limit_refusal(head.host).is_some() {
            // Other newcomers have been stored since this host's hello. The answer to its next hello has the reason.
            self.forget_newcomer(head.host);
            return self.output.reply(from.connection, ToAgent::Unknown);
        }
        // The first batch of a newcomer stores the host, too, which needs two more slots.
        let newcomer_slots = if self.hosts.is_newcomer(head.host) {
            let Some(slots) = self.queue.reserve(0).zip(self.queue.reserve(0)) else {
                return self.defer_batch(head);
            };
            Some(slots)
        } else {
            None
        };
        let Some(slot) = self.queue.reserve(frame.len()) else {
            drop(newcomer_slots);
            return self.defer_batch(head);
        };
        let body = codec::decode_batch_body(frame.clone());
        let size = body.as_ref().map_or(frame.len(), Bytes::len);
        // Decompressed events take more bytes than their frame.
        let Some(slot) = slot.grow_to(size) else {
            drop(newcomer_slots);
            return self.defer_batch(head);
        };
        if body.is_err() {
            self.output.count_damaged_batch(head.host);
        }
        // The slot is reserved first, because an accepted batch must not be lost afterwards.
        let arrival = self.receiving.handle_batch(&head, body.is_ok(), now.mono);
        if matches!(arrival, Arrival::Accept | Arrival::AcceptDamaged)
            && let (Some((introduction_slot, gap_slot)), Some(newcomer)) =
                (newcomer_slots, self.hosts.promote_newcomer(head.host))
        {
            let Newcomer { introduction, missing, .. } = newcomer;
            self.store.streams.record_hello(head.host, introduction.stream);
            introduction_slot.fill(AdmittedWork::Work(Work::Hello(Box::new(introduction))), now.mono);
            if let Some(missing) = missing {
                gap_slot.fill(AdmittedWork::Work(Work::MissingBatches(missing)), now.mono);
            }
        }
        match (arrival, body) {
            (Arrival::Accept, Ok(body)) => slot.fill(AdmittedWork::Batch(head, body), now.mono),
            (Arrival::AcceptDamaged, Err(error)) => {
                let unstorable =
                    UnstorableBatch { head, frame: frame.clone(), body: None, reason: error.to_string() };
                slot.fill(AdmittedWork::Work(Work::UnstorableBatch(Box::new(unstorable))), now.mono);
            }
            (Arrival::Duplicate(reply), _) => {
                // The reply acknowledges the batch, which needs an open database.
                if self.store.is_open() {
                    self.output.reply(from.connection, reply);
                }
                self.output.announce(LiveEvent::Duplicate(head.host));
            }
            (Arrival::Rejected(Some(reply)) | Arrival::Unknown(reply), _) => {
                self.output.reply(from.connection, reply);
            }
            // No accepted batch gets here: `Accept` is for an intact body, and `AcceptDamaged` for a damaged body.
            (Arrival::Pending | Arrival::Rejected(None) | Arrival::Accept | Arrival::AcceptDamaged, _) => {}
        }
    }

    /// Drops a newcomer. Returns whether the host was a newcomer.
    fn forget_newcomer(&mut self, host: HostId) -> bool {
        let Some(newcomer) = self.hosts.remove_newcomer(host) else { return false };
        self.end_dropped_newcomer(newcomer);
        true
    }

    /// Ends the session of a dropped newcomer, unless the host is a newcomer with another stream now.
    fn end_dropped_newcomer(&mut self, Newcomer { introduction, missing, .. }: Newcomer) {
        let host = introduction.host.id;
        if missing.is_some() {
            // The missing range will not be stored, so nothing has to wait for it.
            self.receiving.handle_failed_store(introduction.stream);
        }
        if !self.hosts.is_newcomer(host) {
            self.receiving.handle_goodbye(host);
            self.routes.remove(host);
            self.output.announce(LiveEvent::Forget(host));
        }
    }

    /// Treats a batch that did not fit into the queue as if it had not arrived.
    fn defer_batch(&mut self, head: BatchHead) {
        self.receiving.defer_batch(head.host, head.stream);
        self.output.count_deferred_batch(head.host);
    }

    /// Requests as many deferred batches as the queue has capacity for now.
    fn request_deferred(&mut self) {
        for (host, request) in self.receiving.request_deferred(self.queue.capacity_for(USUAL_BATCH_BYTES)) {
            if let Some(connection) = self.routes.connection_of(host) {
                self.output.reply(connection, request);
            }
        }
    }

    /// Handles a message of the writer's task.
    pub(super) fn handle_store_event(&mut self, event: StoreEvent) {
        match event {
            StoreEvent::Committed(committed) => self.handle_commit(committed),
            StoreEvent::Closed => self.handle_database_closed(),
            StoreEvent::Opened(state) => self.handle_database_opened(*state),
        }
    }

    /// Acknowledges the batches of a transaction that is on disk.
    fn handle_commit(&mut self, committed: CommitResult) {
        for (stream, mark) in committed.marks {
            self.store.streams.marks.insert(stream, mark);
            let acknowledgement = self.receiving.handle_stored(stream, mark);
            if let Some((connection, reply)) =
                acknowledgement.and_then(|(host, reply)| Some((self.routes.connection_of(host)?, reply)))
            {
                self.output.reply(connection, reply);
            }
        }
        // The commit has freed capacity of the queue.
        self.request_deferred();
        for (host, (stored, newest)) in committed.hosts {
            self.output.announce(LiveEvent::Stored(host, stored, newest));
        }
        self.store.add_runs_without_start(committed.runs_without_start);
        for (host, secret) in committed.secrets {
            self.hosts.set_secret(host, secret);
        }
        for (host, run, number) in committed.runs {
            self.output.announce(LiveEvent::Run(host, run, number));
        }
    }

    /// Handles the closing of the database, whose file is missing or unusable. Agents with a session continue to send.
    fn handle_database_closed(&mut self) {
        self.store.close();
    }

    /// Handles the reopening of the database, which may be another database. Every agent has to send its hello again,
    /// so that its spool is compared with the stored state. The writer drops work admitted before.
    fn handle_database_opened(&mut self, state: StoredState) {
        let StoredState { streams, runs, runs_without_start, hosts, host_secrets } = state;
        self.receiving.forget_sessions();
        self.hosts.replace_stored(host_secrets);
        self.queue.start_generation();
        self.store = StoreView::new(streams, runs_without_start);
        for connection in self.routes.clear() {
            self.output.reply(connection, ToAgent::Unknown);
        }
        self.output.announce(LiveEvent::Reopened { runs, hosts });
    }

    /// Drops silent hosts and logs repeated refusals.
    pub(super) fn expire(&mut self, now: Stamp) {
        self.challenges.remove_expired(now.mono);
        let receiving = &self.receiving;
        let silent =
            self.hosts.select_newcomers(|host| !receiving.is_alive(host, NEWCOMER_TIMEOUT, now.mono));
        for host in silent {
            self.forget_newcomer(host);
        }
        // Silent hosts count when the capacity is divided into windows, so they must not keep their share.
        self.receiving.forget_silent(SESSION_TIMEOUT, now.mono);
        let is_silent = |host: &HostId| !self.receiving.is_alive(*host, SESSION_TIMEOUT, now.mono);
        let silent: Vec<HostId> = self.routes.hosts().filter(is_silent).collect();
        for host in silent {
            self.routes.remove(host);
        }
        for (reason, address, times) in self.refusals.remove_expired(now.mono) {
            tracing::warn!(address = address.map(tracing::field::display), %reason, times, "hosts were refused");
        }
    }

    /// Returns and clears the messages to be sent.
    pub(super) fn take_replies(&mut self) -> Vec<(ConnectionId, ToAgent)> {
        self.output.take_replies()
    }

    /// Returns and clears the changes of what connections may send.
    pub(super) fn take_admissions(&mut self) -> Vec<Admission> {
        self.routes.take_admissions()
    }

    /// Returns and clears the events for the live state.
    pub(super) fn take_live_events(&mut self) -> Vec<LiveEvent> {
        self.output.take_live_events()
    }

    /// Returns the numbers of rejected messages since the start.
    pub(super) const fn rejected(&self) -> RejectedCounts {
        self.output.rejected()
    }

    /// Closes the queue. The writer ends when it has stored the queued work.
    pub(super) fn close(&mut self) {
        self.queue.close();
    }
}
