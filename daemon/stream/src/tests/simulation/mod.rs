//! Both ends, a spool on disk and a database, with a transport that loses, repeats, reorders and damages frames.

mod aggregator;
mod expected_content;
mod file;

use std::collections::VecDeque;

use bytes::Bytes;

use self::aggregator::Aggregator;
use self::expected_content::ExpectedContent;
pub(super) use self::file::SpoolFile;
use super::*;

/// Secret of the host, which copies of its state directory share.
const SECRET: HostSecret = HostSecret::from_bytes([7; 32]);

/// Simulated milliseconds in which all waiting events must be stored after the faults end.
const SETTLE_TIMEOUT_MS: i64 = 300_000;

/// Maximum number of turns of both ends in `SETTLE_TIMEOUT_MS`.
const MAX_TURNS: usize = 5_000;

/// An agent and an aggregator with the frames between them.
#[derive(Clone, Debug)]
pub(super) struct Simulation {
    /// Simulated time, milliseconds.
    pub(super) now: i64,
    config: SendingConfig,
    host: HostId,
    /// Number of events that were offered.
    offered: u64,
    /// Number of processes of the agent that were started.
    processes: u64,
    /// Machines with the same host id, each with its own spool file. One machine runs.
    pub(super) machines: Vec<SpoolFile>,
    /// Index of the machine that runs.
    pub(super) machine: usize,
    pub(super) sending: Sending,
    /// Actions for the spool, in order.
    pub(super) jobs: VecDeque<Action>,
    /// `true` while the spool's disk fails.
    pub(super) is_disk_broken: bool,
    /// Number of the current connection.
    connection: u64,
    pub(super) aggregator: Aggregator,
    /// Frames in flight to the aggregator, each with the number of its connection.
    pub(super) up: Vec<(u64, Bytes)>,
    /// Messages in flight to the agent, each with the number of its connection.
    pub(super) down: Vec<(u64, ToAgent)>,
    pub(super) expected_content: ExpectedContent,
}

impl Simulation {
    pub(super) fn new(config: SendingConfig, capacity: usize) -> Self {
        let host = HostId::random();
        let file = SpoolFile::new(StreamId::random());
        let mut simulation = Self {
            now: 0,
            config,
            host,
            offered: 0,
            processes: 1,
            sending: Sending::new(config, super::host(host, "edge"), SECRET, 1, file.state()),
            machines: vec![file],
            machine: 0,
            jobs: VecDeque::new(),
            is_disk_broken: false,
            connection: 1,
            aggregator: Aggregator::new(capacity),
            up: Vec::new(),
            down: Vec::new(),
            expected_content: ExpectedContent::default(),
        };
        simulation.agent(|sending, now| sending.on_connected(now.mono));
        simulation
    }

    pub(super) fn file(&self) -> &SpoolFile {
        &self.machines[self.machine]
    }

    /// Calls the sending end, sends its frames, and queues its actions for the spool.
    pub(super) fn agent<T>(&mut self, act: impl FnOnce(&mut Sending, Stamp) -> T) -> T {
        let result = act(&mut self.sending, at(self.now));
        while let Some(action) = self.sending.next(at(self.now).mono) {
            match action {
                Action::Send(frame) => {
                    if let Some(sent) = self.sending.sent_unspooled() {
                        self.machines[self.machine].record_sent_unspooled(sent);
                    }
                    let frame = Bytes::from(frame);
                    self.expected_content.record_sent(&frame);
                    self.up.push((self.connection, frame));
                }
                job => self.jobs.push_back(job),
            }
        }
        result
    }

    pub(super) fn offer(&mut self) {
        self.offered += 1;
        let event = incident(&self.offered.to_string());
        self.machines[self.machine].counted.total += 1;
        self.agent(|sending, now| sending.offer(&event, now));
    }

    pub(super) fn pass_time(&mut self, millis: i64) {
        self.now += millis;
        self.agent(|sending, now| sending.tick(now));
        self.exchange_live_update();
    }

    /// Lets time pass until the agent's next deadline.
    pub(super) fn pass_to_deadline(&mut self) {
        let pause =
            self.sending.deadline().map(|deadline| (deadline - at(self.now).mono).nanos() / 1_000_000);
        self.pass_time(pause.unwrap_or_default().clamp(1, 20_000));
    }

    /// Simulates the live lane, through which an agent learns that the aggregator has no session of its host.
    fn exchange_live_update(&mut self) {
        if self.sending.is_up() {
            let reply = self.aggregator.handle_live(self.connection, self.host, at(self.now).mono);
            self.down.extend(reply.map(|reply| (self.connection, reply)));
        }
    }

    /// Completes the next action of the spool, or lets it fail.
    pub(super) fn complete_job(&mut self) {
        let Some(job) = self.jobs.pop_front() else { return };
        if self.is_disk_broken {
            let reason = "the disk fails".to_owned();
            self.agent(|sending, now| match job {
                Action::Append { .. } => sending.on_append_failed(reason, now),
                Action::Load { .. } => sending.on_load_failed(reason, now),
                Action::Delete { .. } => sending.on_delete_failed(reason, now),
                Action::Renew { .. } => sending.on_renew_failed(reason, now),
                Action::Send(_) => unreachable!("sending is not an action of the spool"),
            });
            return;
        }
        let loaded = self.apply(&job);
        self.agent(|sending, now| match job {
            Action::Append { .. } => drop(sending.on_appended(now)),
            Action::Load { .. } => drop(sending.on_loaded(loaded, now)),
            Action::Delete { .. } => sending.on_deleted(),
            Action::Renew { .. } => sending.on_renewed(now),
            Action::Send(_) => unreachable!("sending is not an action of the spool"),
        });
    }

    /// Applies an action to the file.
    fn apply(&mut self, job: &Action) -> Vec<SpooledBatch> {
        let file = &mut self.machines[self.machine];
        match job {
            Action::Append { batches, totals } => {
                file.append(batches, totals.clone());
                let stream = file.stream;
                batches.iter().for_each(|batch| self.expected_content.record_appended(stream, batch));
            }
            Action::Load { from, bytes } => return file.load(*from, *bytes),
            Action::Delete { through, chain } => {
                let deleted = file.delete(*through, *chain);
                self.expected_content.check_deletion(&deleted);
            }
            Action::Renew { stream, previous_stream, first, events_before_first } => {
                file.renew(*stream, *previous_stream, *first, *events_before_first);
                self.expected_content.record_renewed(file);
            }
            Action::Send(_) => unreachable!("sending is not an action of the spool"),
        }
        Vec::new()
    }

    /// Delivers a frame to the aggregator. With `keep`, a copy stays in flight.
    pub(super) fn deliver_up(&mut self, index: usize, keep: bool) {
        if self.up.is_empty() {
            return;
        }
        let index = index % self.up.len();
        let (connection, frame) = self.up.remove(index);
        // No copy of a damaged frame stays in flight: in reality, several frames are not damaged in the same way.
        if keep && !self.expected_content.is_damaged(&frame) {
            self.up.insert(index, (connection, frame.clone()));
        }
        let reply = self.aggregator.handle_frame(connection, &frame, at(self.now).mono);
        self.down.extend(reply.map(|reply| (connection, reply)));
    }

    /// Delivers a message to the agent. With `keep` a copy stays in flight. Messages to an earlier connection are lost.
    pub(super) fn deliver_down(&mut self, index: usize, keep: bool) {
        if self.down.is_empty() {
            return;
        }
        let index = index % self.down.len();
        let (connection, message) = if keep { self.down[index].clone() } else { self.down.remove(index) };
        if connection == self.connection {
            let frame = codec::encode(&message);
            let message = codec::decode(&frame).expect("the aggregator's frame is readable");
            self.agent(|sending, now| drop(sending.on_message(&message, now)));
        }
    }

    pub(super) fn lose_up(&mut self, index: usize) {
        if !self.up.is_empty() {
            self.up.remove(index % self.up.len());
        }
    }

    pub(super) fn lose_down(&mut self, index: usize) {
        if !self.down.is_empty() {
            self.down.remove(index % self.down.len());
        }
    }

    /// Flips a bit of a batch in flight. Other frames are excluded: no hash protects them, and the simulated aggregator
    /// panics if the proof of a damaged hello is wrong.
    pub(super) fn damage(&mut self, index: usize, bit: usize) {
        let batches = self.up.iter_mut().filter(|(_, frame)| codec::decode_batch_head(frame).is_some());
        let mut batches: Vec<_> = batches.collect();
        if batches.is_empty() {
            return;
        }
        let count = batches.len();
        let frame = &mut batches[index % count].1;
        let mut damaged = frame.to_vec();
        let bit = bit % (damaged.len() * 8);
        damaged[bit / 8] ^= 1 << (bit % 8);
        *frame = Bytes::from(damaged);
    }

    /// Commits `count` tasks, and sends the acknowledgements.
    pub(super) fn commit(&mut self, count: usize) {
        let streams = self.commit_without_report(count);
        let replies = self.aggregator.report_commit(streams);
        self.down.extend(replies);
    }

    /// Commits `count` tasks, and kills the aggregator before it acknowledges them.
    pub(super) fn commit_and_kill(&mut self, count: usize) {
        self.commit_without_report(count);
        self.aggregator.kill();
    }

    /// Commits `count` tasks. Returns the streams of the stored entries.
    fn commit_without_report(&mut self, count: usize) -> Vec<StreamId> {
        let stored = self.aggregator.commit(count);
        stored.iter().for_each(|(stream, entry)| self.expected_content.record_committed(*stream, entry));
        stored.into_iter().map(|(stream, _)| stream).collect()
    }

    pub(super) fn fail_commit(&mut self) {
        let replies = self.aggregator.fail_commit();
        self.down.extend(replies);
    }

    pub(super) fn disconnect(&mut self) {
        self.connection += 1;
        self.agent(|sending, now| {
            sending.on_disconnected();
            sending.on_connected(now.mono);
        });
    }

    /// Kills the agent and starts an agent at a machine. Before the kill, the disk has performed `done` further actions
    /// whose completion the agent did not learn of.
    pub(super) fn start_agent(&mut self, machine: usize, done: usize) {
        let jobs: Vec<Action> =
            self.jobs.drain(..).take(if self.is_disk_broken { 0 } else { done }).collect();
        jobs.iter().for_each(|job| drop(self.apply(job)));
        self.machine = machine;
        self.processes += 1;
        self.connection += 1;
        let spool = self.machines[self.machine].open_for_process();
        self.sending =
            Sending::new(self.config, super::host(self.host, "edge"), SECRET, self.processes, spool);
        self.agent(|sending, now| sending.on_connected(now.mono));
    }

    /// Copies the spool to another machine.
    pub(super) fn copy(&mut self) {
        // The copy does not contain the shared memory.
        let mut copy = self.file().clone();
        copy.counted = CountedEvents::default();
        self.machines.push(copy);
        self.expected_content.was_spool_copied = true;
    }

    /// Kills the agent and starts the next machine's agent, whose spool may be a copy of an older spool.
    pub(super) fn start_next_machine(&mut self, done: usize) {
        self.start_agent((self.machine + 1) % self.machines.len(), done);
    }

    /// Stops the agent and deletes its spool.
    pub(super) fn delete_spool(&mut self) {
        self.jobs.clear();
        // A late hello of a dead process would count its stream as another abandoned stream.
        self.up.retain(|(_, frame)| codec::decode_batch_head(frame).is_some());
        let file = SpoolFile::new(StreamId::random());
        let old = std::mem::replace(&mut self.machines[self.machine], file);
        self.expected_content.record_deleted_spool(&old);
        self.start_agent(self.machine, 0);
    }

    pub(super) fn back_up(&mut self) {
        self.aggregator.backup = Some(self.aggregator.database.clone());
    }

    pub(super) fn restore(&mut self) {
        if let Some(backup) = self.aggregator.backup.clone() {
            self.aggregator.database = backup;
            self.expected_content.was_database_restored = true;
            self.aggregator.kill();
        }
    }

    /// Ends all faults, and runs until everything in the spool of every machine is stored.
    pub(super) fn settle(&mut self) {
        self.is_disk_broken = false;
        self.settle_machine();
        for other in (0..self.machines.len()).filter(|other| *other != self.machine).collect::<Vec<_>>() {
            self.start_agent(other, usize::MAX);
            self.settle_machine();
        }
    }

    fn settle_machine(&mut self) {
        let limit = self.now + SETTLE_TIMEOUT_MS;
        self.agent(|sending, now| sending.flush(now.wall));
        for _ in 0..MAX_TURNS {
            self.exchange_live_update();
            while !(self.up.is_empty()
                && self.down.is_empty()
                && self.jobs.is_empty()
                && self.aggregator.is_idle())
            {
                self.deliver_up(0, false);
                self.complete_job();
                self.commit(usize::MAX);
                self.deliver_down(0, false);
                self.check();
            }
            let is_settled = self.sending.is_idle() && self.sending.has_reported_all();
            if self.sending.is_up() && is_settled && self.file().batches.is_empty() {
                // The aggregator may have been killed after its welcome. Over the live lane, it then states that the
                // host has no session.
                self.exchange_live_update();
                if self.down.is_empty() {
                    return;
                }
                continue;
            }
            self.pass_to_deadline();
            assert!(self.now < limit, "events still wait after {SETTLE_TIMEOUT_MS} ms: {self:#?}");
        }
        panic!("events still wait after {MAX_TURNS} turns: {self:#?}");
    }

    /// Checks the invariants of every state.
    pub(super) fn check(&self) {
        let Accounting { produced, stored, waiting, dropped, .. } = self.sending.accounting();
        assert_eq!(produced, stored + waiting + dropped, "produced = stored + waiting + dropped");
        if !self.expected_content.was_database_restored && !self.expected_content.was_spool_copied {
            assert_eq!(self.aggregator.missing_batch_reports, 0, "no batch is missing");
        }
    }

    /// Checks the invariants of a settled state.
    pub(super) fn check_settled(&self) {
        self.check();
        self.expected_content.check(&self.aggregator);
        self.expected_content.check_totals(self.offered, &self.aggregator);
        assert!(
            self.machines.iter().all(|file| file.batches.is_empty()),
            "all batches were acknowledged and deleted"
        );
    }
}

/// Returns the number of missing events that the gaps in a body report.
fn missing_in_gaps(events: u32, body: &[u8]) -> u64 {
    let events = codec::decode_events(body, events).expect("the agent's events are readable");
    let count = |event| match event {
        Event::Gap(gap) => gap.count,
        _ => 0,
    };
    events.into_iter().map(count).sum()
}

/// Returns the numbers of the events in a body in order. Gap events have no number.
fn event_numbers(events: u32, body: &[u8]) -> Vec<u64> {
    let events = codec::decode_events(body, events).expect("the agent's events are readable");
    let event_number = |event| match event {
        Event::Incident(incident) => Some(incident.text.parse().expect("a number")),
        _ => None,
    };
    events.into_iter().filter_map(event_number).collect()
}
