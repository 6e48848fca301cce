//! Who may speak, and what becomes of each frame. No sockets here: frames in, replies and news out.

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
use crate::live::News;
use peernet_store::writing::{Aside, Committed, RunName, StoredState, Streams, Work};

/// A host that was silent for so long is asked to say hello again.
const FORGET_SESSIONS: Span = Span::from_seconds(60);
/// A host of which nothing is stored leaves after this silence: agents speak four times a second.
const FORGET_NEWCOMERS: Span = Span::from_seconds(10);
/// Bytes of a batch as agents cut them, as a rule: by them it is reckoned how many there is room for.
const USUAL_BATCH: usize = 128 * 1024;

/// Decides about every frame.
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
    /// A session that knows nobody; `hosts` and `streams` are what is stored, `unknown` the runs of which the store knows iterations
    /// only.
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

    /// A frame came from a connection.
    pub(super) fn frame(&mut self, from: &Peer, frame: &Bytes, now: Stamp) {
        if let Some(part) = codec::part(frame) {
            if self.knows(from, part.host)
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
                if self.knows(from, update.host) && self.receiving.live(update.host, now.mono).is_none() {
                    self.name_runs(&update, now.mono);
                    self.output.announce(News::Update(Box::new(update)));
                }
            }
            Ok(ToAggregator::Echo { host, bytes }) => {
                if self.knows(from, host) {
                    self.output.reply(from.connection, self.receiving.echo(host, bytes, now.mono));
                }
            }
            Ok(ToAggregator::Goodbye(host)) => {
                if self.knows(from, host) && !self.forget_newcomer(host) {
                    self.receiving.goodbye(host);
                    self.routes.leave(host);
                    // Without room the next hello of the host ends its runs.
                    if let Some(place) = self.queue.place(0) {
                        place.put(Incoming::Work(Work::Goodbye(host)), now.mono);
                    }
                    self.output.announce(News::Goodbye(host));
                }
            }
            Err(_) => {
                self.output.reject_unreadable();
            }
        }
    }

    /// The live lane names runs whose beginning the store never got: it was acknowledged into another database.
    fn name_runs(&mut self, update: &LiveUpdate, now: MonoTime) {
        if !self.store.has_unnamed() {
            return;
        }
        for live in &update.pipelines {
            let Some(run) = live.run.filter(|run| self.store.is_unnamed(update.host, *run)) else {
                continue;
            };
            // Without room, a later update does.
            let Some(place) = self.queue.place(0) else { return };
            let (host, pipeline, placement) = (update.host, live.pipeline.clone(), live.placement.clone());
            let name = RunName { host, run, pipeline, placement };
            place.put(Incoming::Work(Work::Name(Box::new(name))), now);
            self.store.named(update.host, run);
        }
    }

    /// Whether the host said hello on that connection; one that did not is asked to.
    fn knows(&mut self, from: &Peer, host: HostId) -> bool {
        let known = self.routes.of(host) == Some(from.connection);
        if !known {
            self.output.reject_stranger(from.connection);
        }
        known
    }

    /// A connection has ended. Its hosts say hello again on their next one; of newcomers nothing is kept.
    pub(super) fn gone(&mut self, connection: ConnectionId) {
        self.challenges.forget(&connection);
        let routes = &self.routes;
        for host in self.hosts.newcomers_that(|host| routes.of(host) == Some(connection)) {
            self.forget_newcomer(host);
        }
    }

    fn batch(&mut self, from: &Peer, head: BatchHead, frame: &Bytes, now: Stamp) {
        if !self.knows(from, head.host) {
            return;
        }
        // The first batch of a host brings the host.
        let before = if self.hosts.is_newcomer(head.host) {
            let Some(places) = self.queue.place(0).zip(self.queue.place(0)) else { return self.defer(head) };
            Some(places)
        } else {
            None
        };
        let Some(place) = self.queue.place(frame.len()) else {
            drop(before);
            return self.defer(head);
        };
        let body = codec::batch_body(frame.clone());
        let size = body.as_ref().map_or(frame.len(), Bytes::len);
        // Compressed events take more room than their frame.
        let Some(place) = place.grown_to(size) else {
            drop(before);
            return self.defer(head);
        };
        if body.is_err() {
            self.output.reject_damaged(head.host);
        }
        let arrival = self.receiving.batch(&head, body.is_ok(), now.mono);
        if matches!(arrival, Arrival::Accept | Arrival::AcceptDamaged)
            && let (Some((greeting, hole)), Some(newcomer)) = (before, self.hosts.store(head.host))
        {
            let Newcomer { introduction, missing, .. } = newcomer;
            self.store.streams.came(head.host, introduction.stream);
            greeting.put(Incoming::Work(Work::Hello(Box::new(introduction))), now.mono);
            if let Some(missing) = missing {
                hole.put(Incoming::Work(Work::Missing(missing)), now.mono);
            }
        }
        match (arrival, body) {
            (Arrival::Accept, Ok(body)) => place.put(Incoming::Batch(head, body), now.mono),
            (Arrival::AcceptDamaged, Err(error)) => {
                let aside = Aside { head, frame: frame.clone(), body: None, reason: error.to_string() };
                place.put(Incoming::Work(Work::Aside(Box::new(aside))), now.mono);
            }
            (Arrival::Duplicate(reply), _) => {
                if self.store.is_open() {
                    self.output.reply(from.connection, reply);
                }
                self.output.announce(News::Duplicate(head.host));
            }
            (Arrival::Hole(Some(reply)) | Arrival::Unknown(reply), _) => {
                self.output.reply(from.connection, reply);
            }
            (Arrival::Pending | Arrival::Hole(None) | Arrival::Accept | Arrival::AcceptDamaged, _) => {}
        }
    }

    /// Forgets a host of which nothing is stored; whether there was one.
    fn forget_newcomer(&mut self, host: HostId) -> bool {
        let Some(newcomer) = self.hosts.forget(host) else { return false };
        self.left(newcomer);
        true
    }

    /// A newcomer is no longer kept, with this stream.
    fn left(&mut self, Newcomer { introduction, missing, .. }: Newcomer) {
        let host = introduction.host.id;
        if missing.is_some() {
            // It waits for nothing that will be stored.
            self.receiving.failed(introduction.stream);
        }
        if !self.hosts.is_newcomer(host) {
            self.receiving.goodbye(host);
            self.routes.leave(host);
            self.output.announce(News::Forget(host));
        }
    }

    /// There is no room for a batch: it counts as never come.
    fn defer(&mut self, head: BatchHead) {
        self.receiving.deferred(head.stream);
        self.output.defer_batch(head.host);
    }

    /// Asks for what found no room, as far as there is some now.
    fn ask_for_deferred(&mut self) {
        for (host, request) in self.receiving.room(self.queue.room_for(USUAL_BATCH)) {
            if let Some(route) = self.routes.of(host) {
                self.output.reply(route, request);
            }
        }
    }

    /// The writer tells what became of the database.
    pub(super) fn store_event(&mut self, event: StoreEvent) {
        match event {
            StoreEvent::Committed(committed) => self.committed(committed),
            StoreEvent::Closed => self.database_closed(),
            StoreEvent::Opened(state) => self.database_opened(*state),
        }
    }

    /// A transaction is on disk.
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
        self.ask_for_deferred();
        for (host, (stored, newest)) in committed.hosts {
            self.output.announce(News::Stored(host, stored, newest));
        }
        self.store.add_unnamed(committed.unknown);
        for (host, secret) in committed.secrets {
            self.hosts.checked(host, secret);
        }
        for (host, run, number) in committed.runs {
            self.output.announce(News::Run(host, run, number));
        }
    }

    /// The database was closed: its file is away or cannot be used. Agents that are known go on sending.
    fn database_closed(&mut self) {
        self.store.close();
    }

    /// The database was opened anew, and may be another one: every agent has to say hello again, so that its spool is
    /// compared with what is stored now. What was let in before is dropped by the writer.
    fn database_opened(&mut self, state: StoredState) {
        let StoredState { streams, runs, unknown, hosts, known } = state;
        self.receiving.forget_sessions();
        self.hosts.restart(known);
        self.queue.begin_generation();
        self.store = StoreView::new(streams, unknown);
        for route in self.routes.clear() {
            self.output.reply(route, ToAgent::Unknown);
        }
        self.output.announce(News::Reopened { runs, hosts });
    }

    /// Time has passed.
    pub(super) fn age(&mut self, now: Stamp) {
        self.challenges.age(now.mono);
        let receiving = &self.receiving;
        let silent = self.hosts.newcomers_that(|host| !receiving.is_alive(host, FORGET_NEWCOMERS, now.mono));
        for host in silent {
            self.forget_newcomer(host);
        }
        self.receiving.forget_silent(FORGET_SESSIONS, now.mono);
        let is_silent = |host: &HostId| !self.receiving.is_alive(*host, FORGET_SESSIONS, now.mono);
        let silent: Vec<HostId> = self.routes.hosts().filter(is_silent).collect();
        for host in silent {
            self.routes.leave(host);
        }
        for (reason, address, times) in self.refusals.age(now.mono) {
            tracing::warn!(address = address.map(tracing::field::display), %reason, times, "hosts were refused");
        }
    }

    /// What is to be sent, and to whom.
    pub(super) fn take_replies(&mut self) -> Vec<(ConnectionId, ToAgent)> {
        self.output.take_replies()
    }

    /// Which connections have a host from now on, and which have none any more.
    pub(super) fn take_admissions(&mut self) -> Vec<Admission> {
        self.routes.take_admissions()
    }

    /// What the live picture should know.
    pub(super) fn take_news(&mut self) -> Vec<News> {
        self.output.take_news()
    }

    /// What could not be taken, since the start.
    pub(super) const fn rejected(&self) -> RejectedCounts {
        self.output.rejected()
    }

    /// Lets nothing more in: the writer ends when it has stored what waits.
    pub(super) fn close(&mut self) {
        self.queue.close();
    }
}
