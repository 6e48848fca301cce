//! The outbox task: between the feed, the sending end of the event stream, and the connection.

use std::pin::pin;
use std::time::Duration;

use futures::FutureExt;
use futures::future::BoxFuture;
use peernet_clock::SharedClock;
use peernet_logger::stream::{
    Accounting, Event, HostClock, HostMetrics, IncidentKind, LiveUpdate, Notice, Sending, Spool, SpoolError,
    ToAgent, ToAggregator, codec,
};
use peernet_networks::Address;
use tokio::sync::{oneshot, watch};
use tokio::time::{Instant, MissedTickBehavior};

use super::connection::Connection;
use super::farewell::{Farewell, Next};
use super::feed::Exit;
use crate::host::Host;
use crate::incidents::{Concerning, Incidents};
use crate::link::Links;
use crate::live::{self, Board};
use crate::pauses::Pauses;
use crate::runs::Runs;

/// How often the feed is emptied. Looking is cheaper than being woken for each event, above all for the
/// pipeline that would have to do the waking.
const LOOK: Duration = Duration::from_millis(20);

/// How long an aggregator may take to answer the hello; its machine may be busy, but not for this long.
const WELCOME: Duration = Duration::from_secs(5);

/// How long the goodbye may take to go out.
const LINGER: Duration = Duration::from_millis(250);

/// What the task works with.
pub(super) struct Sender<S> {
    machine: Sending<S>,
    exit: Exit,
    board: Board,
    metrics: watch::Receiver<HostMetrics>,
    accounting: watch::Sender<Accounting>,
    clock: SharedClock,
    incidents: Incidents,
    runs: Runs,
    links: Links,
    own: watch::Receiver<HostClock>,
    /// A frame that the connection had no room for.
    held: Option<Vec<u8>>,
    /// The trouble that was reported last: each is reported once.
    said: Option<String>,
}

/// The state of the connection.
enum Line {
    /// Waiting for the next try, or trying.
    Dialling(BoxFuture<'static, Result<Connection, String>>),
    Open(Connection),
}

impl<S: Spool> Sender<S> {
    pub(super) fn new(
        machine: Sending<S>,
        exit: Exit,
        (board, metrics): (Board, watch::Receiver<HostMetrics>),
        accounting: watch::Sender<Accounting>,
        host: &Host,
    ) -> Self {
        let (clock, incidents) = (SharedClock::clone(&host.clock), host.incidents.clone());
        let (runs, links, own) = (host.runs.clone(), host.links.clone(), host.own.clone());
        let (held, said) = (None, None);
        Self { machine, exit, board, metrics, accounting, clock, incidents, runs, links, own, held, said }
    }

    /// Sends until it is told to stop, and by when: then what is left, as long as it is taken.
    pub(super) async fn run(
        mut self,
        address: Address,
        mut pauses: Pauses,
        stop: oneshot::Receiver<Instant>,
    ) {
        let mut looks = tokio::time::interval(LOOK);
        let mut shows = tokio::time::interval(live::INTERVAL);
        for ticks in [&mut looks, &mut shows] {
            ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        }
        let mut stopping = pin!(told(stop));
        let mut farewell: Option<Farewell> = None;
        let mut alarm = pin!(tokio::time::sleep(Duration::ZERO));
        let mut welcome = pin!(tokio::time::sleep(Duration::ZERO));
        // Whether the connection is there, but nothing was heard on it yet.
        let mut unanswered = false;
        let mut line = dial(&address, Duration::ZERO);
        loop {
            tokio::select! {
                biased;
                deadline = &mut stopping, if farewell.is_none() => {
                    farewell = Some(Farewell::begin(Instant::now(), deadline, self.machine.accounting().stored));
                    self.take();
                    self.machine.flush(self.clock.wall());
                    if matches!(line, Line::Dialling(_)) {
                        // There is no time for a pause.
                        line = dial(&address, Duration::ZERO);
                    }
                }
                _ = shows.tick() => self.show(&line),
                event = next(&mut line) => match event {
                    Happened::Connected(connection) => {
                        unanswered = true;
                        welcome.as_mut().reset(Instant::now() + WELCOME);
                        self.machine.connected(self.clock.mono());
                        line = Line::Open(connection);
                    }
                    Happened::Failed(reason) => {
                        self.away(&address, &reason);
                        line = dial(&address, pauses.grow());
                    }
                    Happened::Gone(reason) => {
                        unanswered = false;
                        self.machine.disconnected();
                        self.held = None;
                        self.away(&address, &reason);
                        line = dial(&address, pauses.grow());
                    }
                    Happened::Message(frame) => {
                        if self.hear(&frame) {
                            unanswered = false;
                            pauses.reset();
                        }
                    }
                },
                () = &mut welcome, if unanswered => {
                    unanswered = false;
                    self.machine.disconnected();
                    self.held = None;
                    self.say(IncidentKind::Disconnected, format!(
                        "connected to {address}, but no aggregator answers there; is it the event port (5550) of \
                         an aggregator? It is tried again, events wait"
                    ));
                    line = dial(&address, pauses.grow());
                }
                _ = looks.tick() => self.take(),
                () = &mut alarm, if farewell.is_some() => {}
            }
            self.transmit(&line);
            self.publish();
            if let Some(farewell) = &mut farewell {
                let account = self.machine.accounting();
                match farewell.next(Instant::now(), account.stored, account.waiting) {
                    Next::Wait(until) => alarm.as_mut().reset(until),
                    Next::Frames if self.machine.is_up() => {
                        self.give_up();
                        self.transmit(&line);
                    }
                    Next::Frames | Next::Leave => break,
                }
            }
        }
        self.leave(line).await;
    }

    /// Empties the feed.
    fn take(&mut self) {
        let now = self.clock.stamp();
        while let Ok(event) = self.exit.queue.try_recv() {
            self.machine.offer(&event, now);
        }
        for gap in self.exit.overflow.take_gaps() {
            self.machine.offer(&Event::Gap(gap), now);
        }
        self.machine.tick(now);
    }

    /// Sends a live update, if the aggregator wants one and the connection takes it now.
    fn show(&mut self, line: &Line) {
        let Line::Open(connection) = line else { return };
        if !self.machine.is_up() || self.held.is_some() {
            return;
        }
        let (pipelines, receipt) = self.board.look();
        let update = LiveUpdate {
            host: self.machine.host(),
            sent: self.clock.wall(),
            pipelines,
            links: self.links.live(),
            clock: self.own.borrow().clone(),
            metrics: self.metrics.borrow().clone(),
            accounting: self.count(),
        };
        if connection.send(codec::encode(&ToAggregator::Live(update))).is_ok() {
            self.board.delivered(&receipt);
        }
    }

    /// Sends what is due on the durable lane.
    fn transmit(&mut self, line: &Line) {
        let Line::Open(connection) = line else { return };
        loop {
            let frame = match self.held.take() {
                Some(frame) => Ok(Some(frame)),
                None => self.machine.transmit(self.clock.mono()),
            };
            match frame {
                Ok(Some(frame)) => {
                    if let Err(back) = connection.send(frame) {
                        self.held = Some(back);
                        return;
                    }
                }
                Ok(None) => return,
                Err(error) => return self.spool_failed(&error),
            }
        }
    }

    /// Returns whether it was an aggregator that spoke.
    fn hear(&mut self, frame: &[u8]) -> bool {
        let message: ToAgent = match codec::decode(frame) {
            Ok(message) => message,
            Err(error) => {
                tracing::warn!(%error, "what the aggregator sent makes no sense and is dropped");
                return false;
            }
        };
        match self.machine.received(&message, self.clock.stamp()) {
            Ok(None) => {}
            Ok(Some(notice)) => self.noticed(notice),
            Err(error) => self.spool_failed(&error),
        }
        true
    }

    fn noticed(&mut self, notice: Notice) {
        match notice {
            Notice::Welcomed { aggregator, stored } => {
                self.said = None;
                // It may have been started anew and know no second of ours.
                self.board.start_over();
                if stored == 0 && self.machine.accounting().stored > 0 {
                    self.tell_of_runs();
                }
                let text = match stored {
                    0 => format!("connected to the aggregator {aggregator}"),
                    stored => {
                        format!("connected to the aggregator {aggregator}, which has batches up to {stored}")
                    }
                };
                self.incidents.report(IncidentKind::Connected, Concerning::default(), text);
            }
            Notice::Refused(reason) => {
                let text = format!("the aggregator refuses this agent and is asked again: {reason}");
                self.say(IncidentKind::Refused, text);
            }
            Notice::StreamRenewed { stored, newest } => {
                let text = format!(
                    "the aggregator has batches up to {stored} of a stream that ends at {newest} here: the spool is \
                     a copy or a restored one; what it holds goes on in a new stream"
                );
                self.incidents.report(IncidentKind::Gap, Concerning::default(), text);
                self.tell_of_runs();
            }
        }
    }

    /// The aggregator does not have what it once stored: without the start of its run an iteration means little.
    fn tell_of_runs(&mut self) {
        let now = self.clock.stamp();
        for event in self.runs.beginnings() {
            self.machine.offer(&event, now);
        }
    }

    /// There is no time for everything: what waits is given up, but that the runs began and ended is told.
    fn give_up(&mut self) {
        let now = self.clock.stamp();
        match self.machine.give_up(now) {
            Ok(events) => {
                tracing::warn!(events, "stopping: gave up events that the aggregator did not take in time");
            }
            Err(error) => return self.spool_failed(&error),
        }
        self.held = None;
        for event in self.runs.frames() {
            self.machine.offer(&event, now);
        }
        self.machine.flush(now.wall);
    }

    fn away(&mut self, address: &Address, reason: &str) {
        if self.said.is_none() {
            let text = format!(
                "no connection to the aggregator at {address}: {reason}; measuring goes on, events wait, and it is \
                 tried again every {} to {} s",
                Pauses::SHORTEST.as_secs_f64(),
                Pauses::LONGEST.as_secs()
            );
            self.say(IncidentKind::Disconnected, text);
        }
    }

    fn spool_failed(&mut self, error: &SpoolError) {
        self.say(IncidentKind::Gap, error.to_string());
    }

    fn say(&mut self, kind: IncidentKind, text: String) {
        if self.said.as_ref() != Some(&text) {
            self.incidents.report(kind, Concerning::default(), text.clone());
            self.said = Some(text);
        }
    }

    /// The machine's account and what has not reached it.
    fn count(&self) -> Accounting {
        let mut account = self.machine.accounting();
        let (queued, dropped) = (self.exit.queue.len() as u64, self.exit.overflow.dropped());
        account.offered += queued + dropped;
        account.waiting += queued;
        account.dropped += dropped;
        account
    }

    fn publish(&self) {
        let account = self.count();
        self.accounting.send_if_modified(|shown| std::mem::replace(shown, account) != account);
    }

    async fn leave(mut self, line: Line) {
        let account = self.count();
        if account.waiting > 0 {
            tracing::warn!(events = account.waiting, "stopped before the aggregator had everything");
        }
        if let Line::Open(connection) = line {
            if let Some(goodbye) = self.machine.goodbye()
                && connection.send(goodbye).is_err()
            {
                tracing::debug!("the connection had no room for a goodbye");
            }
            connection.close(LINGER).await;
        }
        self.publish();
    }
}

/// By when to end, once somebody says so.
async fn told(stop: oneshot::Receiver<Instant>) -> Instant {
    match stop.await {
        Ok(deadline) => deadline,
        Err(_) => std::future::pending().await,
    }
}

/// What happened on the line.
enum Happened {
    Connected(Connection),
    Failed(String),
    Gone(String),
    Message(bytes::Bytes),
}

async fn next(line: &mut Line) -> Happened {
    match line {
        Line::Dialling(dialling) => match dialling.await {
            Ok(connection) => Happened::Connected(connection),
            Err(reason) => Happened::Failed(reason),
        },
        Line::Open(connection) => match connection.receive().await {
            // What is not one frame is no message of ours; decoding says so.
            Ok(message) => Happened::Message(message.part_bytes(0).unwrap_or_default()),
            Err(reason) => Happened::Gone(reason),
        },
    }
}

fn dial(address: &Address, pause: Duration) -> Line {
    let address = address.clone();
    Line::Dialling(
        async move {
            tokio::time::sleep(pause).await;
            Connection::open(&address).await
        }
        .boxed(),
    )
}
