//! The decisions about each frame and each host. Free of I/O: frames go in, replies and live events come out.

mod greeting;
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
use super::queue::{Incoming, Queue};
use super::routes::{Admission, Routes};
use crate::live::LiveEvent;
use peernet_store::writing::{Committed, RunName, StoredState, Streams, UnstorableBatch, Work};

/// Time without messages after which a host loses its session and has to send its hello again.
const FORGET_SESSIONS: Span = Span::from_seconds(60);
/// Time without messages after which a newcomer is dropped. Agents send four messages a second.
const FORGET_NEWCOMERS: Span = Span::from_seconds(10);
/// Usual size of a batch as agents cut them, bytes. The number of batches that have room is computed with it.
const USUAL_BATCH: usize = 128 * 1024;

/// The state of ingest, which decides about each frame.
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
    /// Creates the state without sessions. `hosts` and `streams` come from the database; `unknown` are runs of which
    /// the database has iterations only.
    pub(crate) fn new(
        receiving: Receiving,
        challenges: Challenges<ConnectionId>,
        hosts: Hosts,
        queue: Queue,
        streams: Streams,
        unknown: Vec<(HostId, RunId)>,
    ) -> Self {
        Self {
            receiving,
            challenges,
            hosts,
            queue,
            routes: Routes::default(),
            store: StoreView::new(streams, unknown),
            refusals: LogThrottle::default(),
            output: SessionOutput::default(),
        }
    }

    /// Processes a frame of a connection.
    pub(super) fn frame(&mut self, from: &Peer, frame: &Bytes, now: Stamp) {
        // The kind of a frame is decided by its first bytes, so that batches are not decoded twice.
        if let Some(part) = codec::part(frame) {
            if self.has_session(from, part.host)
                && let Some(frame) = self.receiving.part(&part, now.mono)
                && let Some(head) = codec::batch_head(&frame)
            {
                self.batch(from, head, &frame, now);
            }
            return;
        }
        if let Some(head) = codec::batch_head(frame) {
            self.batch(from, head, frame, now);
            return;
        }
        match codec::decode(frame) {
            Ok(ToAggregator::Hello(hello)) => self.hello(from, hello, now),
            Ok(ToAggregator::Proof(proof)) => self.proof(from, proof, now),
            Ok(ToAggregator::Live(update)) => {
                if self.has_session(from, update.host) && self.receiving.live(update.host, now.mono).is_none()
                {
                    self.name_runs(&update, now.mono);
                    self.output.announce(LiveEvent::Update(Box::new(update)));
                }
            }
            Ok(ToAggregator::Echo { host, bytes }) => {
                if self.has_session(from, host) {
                    self.output.reply(from.connection, self.receiving.echo(host, bytes, now.mono));
                }
            }
            Ok(ToAggregator::Goodbye(host)) => {
                if self.has_session(from, host) && !self.forget_newcomer(host) {
                    self.receiving.goodbye(host);
                    self.routes.leave(host);
                    // Without room, the next hello of the host ends its runs.
                    if let Some(slot) = self.queue.reserve(0) {
                        slot.put(Incoming::Work(Work::Goodbye(host)), now.mono);
                    }
                    self.output.announce(LiveEvent::Goodbye(host));
                }
            }
            Err(_) => {
                self.output.reject_unreadable();
            }
        }
    }

    /// Stores the names of runs whose start is not in this database because it was acknowledged into another one. The
    /// live lane states them.
    fn name_runs(&mut self, update: &LiveUpdate, now: MonoTime) {
        if !self.store.has_unnamed() {
            return;
        }
        for live in &update.pipelines {
            let Some(run) = live.run.filter(|run| self.store.is_unnamed(update.host, *run)) else {
                continue;
            };
            // Without room, a later update is used.
            let Some(slot) = self.queue.reserve(0) else { return };
            let (host, pipeline, placement) = (update.host, live.pipeline.clone(), live.placement.clone());
            let name = RunName { host, run, pipeline, placement };
            slot.put(Incoming::Work(Work::Name(Box::new(name))), now);
            self.store.named(update.host, run);
        }
    }

    /// Returns whether the host has a session on the connection. If not, the agent is asked for its hello.
    fn has_session(&mut self, from: &Peer, host: HostId) -> bool {
        let known = self.routes.of(host) == Some(from.connection);
        if !known {
            self.output.reject_stranger(from.connection);
        }
        known
    }

    /// Handles the end of a connection. Its stored hosts send their hello on the next connection; its newcomers are
    /// dropped.
    pub(super) fn connection_closed(&mut self, connection: ConnectionId) {
        self.challenges.forget(&connection);
        let routes = &self.routes;
        for host in self.hosts.newcomers_where(|host| routes.of(host) == Some(connection)) {
            self.forget_newcomer(host);
        }
    }

    /// Admits a batch to the queue, or requests it again if there is no room.
    fn batch(&mut self, from: &Peer, head: BatchHead, frame: &Bytes, now: Stamp) {
        if !self.has_session(from, head.host) {
            return;
        }
        // The first batch of a newcomer stores the host, too, which needs two more slots.
        let before = if self.hosts.is_newcomer(head.host) {
            let Some(slots) = self.queue.reserve(0).zip(self.queue.reserve(0)) else {
                return self.defer(head);
            };
            Some(slots)
        } else {
            None
        };
        let Some(slot) = self.queue.reserve(frame.len()) else {
            drop(before);
            return self.defer(head);
        };
        let body = codec::batch_body(frame.clone());
        let size = body.as_ref().map_or(frame.len(), Bytes::len);
        // Decompressed events need more room than their frame.
        let Some(slot) = slot.grown_to(size) else {
            drop(before);
            return self.defer(head);
        };
        if body.is_err() {
            self.output.reject_damaged(head.host);
        }
        // Room is reserved before: a batch that is accepted must not be lost afterwards.
        let arrival = self.receiving.batch(&head, body.is_ok(), now.mono);
        if matches!(arrival, Arrival::Accept | Arrival::AcceptDamaged)
            && let (Some((greeting, hole)), Some(newcomer)) = (before, self.hosts.store(head.host))
        {
            let Newcomer { introduction, missing, .. } = newcomer;
            self.store.streams.came(head.host, introduction.stream);
            greeting.put(Incoming::Work(Work::Hello(Box::new(introduction))), now.mono);
            if let Some(missing) = missing {
                hole.put(Incoming::Work(Work::MissingBatches(missing)), now.mono);
            }
        }
        match (arrival, body) {
            (Arrival::Accept, Ok(body)) => slot.put(Incoming::Batch(head, body), now.mono),
            (Arrival::AcceptDamaged, Err(error)) => {
                let aside =
                    UnstorableBatch { head, frame: frame.clone(), body: None, reason: error.to_string() };
                slot.put(Incoming::Work(Work::UnstorableBatch(Box::new(aside))), now.mono);
            }
            (Arrival::Duplicate(reply), _) => {
                // The reply acknowledges the batch, which needs an open database.
                if self.store.is_open() {
                    self.output.reply(from.connection, reply);
                }
                self.output.announce(LiveEvent::Duplicate(head.host));
            }
            (Arrival::Hole(Some(reply)) | Arrival::Unknown(reply), _) => {
                self.output.reply(from.connection, reply);
            }
            (Arrival::Pending | Arrival::Hole(None) | Arrival::Accept | Arrival::AcceptDamaged, _) => {}
        }
    }

    /// Drops a newcomer. Returns whether the host was one.
    fn forget_newcomer(&mut self, host: HostId) -> bool {
        let Some(newcomer) = self.hosts.forget(host) else { return false };
        self.end_dropped_newcomer(newcomer);
        true
    }

    /// Ends the session of a dropped newcomer, unless the host is a newcomer with another stream now.
    fn end_dropped_newcomer(&mut self, Newcomer { introduction, missing, .. }: Newcomer) {
        let host = introduction.host.id;
        if missing.is_some() {
            // The missing range will not be stored, so nothing has to wait for it.
            self.receiving.failed(introduction.stream);
        }
        if !self.hosts.is_newcomer(host) {
            self.receiving.goodbye(host);
            self.routes.leave(host);
            self.output.announce(LiveEvent::Forget(host));
        }
    }

    /// Treats a batch without room as if it had not arrived.
    fn defer(&mut self, head: BatchHead) {
        self.receiving.deferred(head.stream);
        self.output.defer_batch(head.host);
    }

    /// Requests deferred batches as far as there is room now.
    fn ask_for_deferred(&mut self) {
        for (host, request) in self.receiving.room(self.queue.room_for(USUAL_BATCH)) {
            if let Some(route) = self.routes.of(host) {
                self.output.reply(route, request);
            }
        }
    }

    /// Handles a message of the writer's task.
    pub(super) fn store_event(&mut self, event: StoreEvent) {
        match event {
            StoreEvent::Committed(committed) => self.committed(committed),
            StoreEvent::Closed => self.database_closed(),
            StoreEvent::Opened(state) => self.database_opened(*state),
        }
    }

    /// Acknowledges the batches of a transaction that is on disk.
    fn committed(&mut self, committed: Committed) {
        for (stream, mark) in committed.marks {
            self.store.streams.marks.insert(stream, mark);
            let listener = self.receiving.stored(stream, mark);
            if let Some((route, reply)) =
                listener.and_then(|(host, reply)| Some((self.routes.of(host)?, reply)))
            {
                self.output.reply(route, reply);
            }
        }
        // The commit has freed room in the queue.
        self.ask_for_deferred();
        for (host, (stored, newest)) in committed.hosts {
            self.output.announce(LiveEvent::Stored(host, stored, newest));
        }
        self.store.add_unnamed(committed.unknown);
        for (host, secret) in committed.secrets {
            self.hosts.set_secret(host, secret);
        }
        for (host, run, number) in committed.runs {
            self.output.announce(LiveEvent::Run(host, run, number));
        }
    }

    /// Handles the closing of the database, whose file is missing or unusable. Agents with a session continue to send.
    fn database_closed(&mut self) {
        self.store.close();
    }

    /// Handles the reopening of the database, which may be another one. Every agent has to send its hello again, so
    /// that its spool is compared with the stored state. The writer drops work admitted before.
    fn database_opened(&mut self, state: StoredState) {
        let StoredState { streams, runs, unknown, hosts, known } = state;
        self.receiving.forget_sessions();
        self.hosts.restart(known);
        self.queue.begin_generation();
        self.store = StoreView::new(streams, unknown);
        for route in self.routes.clear() {
            self.output.reply(route, ToAgent::Unknown);
        }
        self.output.announce(LiveEvent::Reopened { runs, hosts });
    }

    /// Drops silent hosts and logs repeated refusals.
    pub(super) fn age(&mut self, now: Stamp) {
        self.challenges.age(now.mono);
        let receiving = &self.receiving;
        let silent = self.hosts.newcomers_where(|host| !receiving.is_alive(host, FORGET_NEWCOMERS, now.mono));
        for host in silent {
            self.forget_newcomer(host);
        }
        // Silent hosts count in the division of the windows, so they must not keep their share.
        self.receiving.forget_silent(FORGET_SESSIONS, now.mono);
        let is_silent = |host: &HostId| !self.receiving.is_alive(*host, FORGET_SESSIONS, now.mono);
        let silent: Vec<HostId> = self.routes.hosts().filter(is_silent).collect();
        for host in silent {
            self.routes.leave(host);
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

    /// Returns and clears the events for the live picture.
    pub(super) fn take_live_events(&mut self) -> Vec<LiveEvent> {
        self.output.take_live_events()
    }

    /// Returns the numbers of rejected messages since the start.
    pub(super) const fn rejected(&self) -> RejectedCounts {
        self.output.rejected()
    }

    /// Closes the queue. The writer ends when it has stored what waits.
    pub(super) fn close(&mut self) {
        self.queue.close();
    }
}
