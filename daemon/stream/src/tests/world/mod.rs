//! Both ends, a spool on disk, a database, and between them a transport that loses, repeats, reorders and damages.

mod aggregator;
mod file;
mod truth;

use std::collections::VecDeque;

use bytes::Bytes;

use self::aggregator::Aggregator;
pub(super) use self::file::SpoolFile;
use self::truth::Truth;
use super::*;

/// The host's secret, which copies of its state directory share.
const SECRET: HostSecret = HostSecret::from_bytes([7; 32]);

/// Simulated milliseconds in which everything that waits must be stored once the faults end.
const PATIENCE_MS: i64 = 300_000;

/// How often either end may do something in that time.
const MOST_TURNS: usize = 5_000;

#[derive(Clone, Debug)]
pub(super) struct World {
    pub(super) now: i64,
    config: SendingConfig,
    host: HostId,
    offered: u64,
    processes: u64,
    /// Machines with the same host id, each with a spool file of its own; one of them runs.
    pub(super) sites: Vec<SpoolFile>,
    pub(super) site: usize,
    pub(super) sending: Sending,
    /// What the spool is to do, in order.
    pub(super) jobs: VecDeque<Action>,
    /// The spool's disk fails.
    pub(super) broken: bool,
    connection: u64,
    pub(super) aggregator: Aggregator,
    pub(super) up: Vec<(u64, Bytes)>,
    pub(super) down: Vec<(u64, ToAgent)>,
    pub(super) truth: Truth,
}

impl World {
    pub(super) fn new(config: SendingConfig, capacity: usize) -> Self {
        let host = HostId::random();
        let file = SpoolFile::new(StreamId::random());
        let mut world = Self {
            now: 0,
            config,
            host,
            offered: 0,
            processes: 1,
            sending: Sending::new(config, super::host(host, "edge"), SECRET, 1, file.open()),
            sites: vec![file],
            site: 0,
            jobs: VecDeque::new(),
            broken: false,
            connection: 1,
            aggregator: Aggregator::new(capacity),
            up: Vec::new(),
            down: Vec::new(),
            truth: Truth::default(),
        };
        world.agent(|sending, now| sending.connected(now.mono));
        world
    }

    pub(super) fn file(&self) -> &SpoolFile {
        &self.sites[self.site]
    }

    /// Does something to the sender, and what it then wants.
    pub(super) fn agent<T>(&mut self, act: impl FnOnce(&mut Sending, Stamp) -> T) -> T {
        let done = act(&mut self.sending, at(self.now));
        while let Some(action) = self.sending.next(at(self.now).mono) {
            match action {
                Action::Send(frame) => {
                    if let Some(sent) = self.sending.sent_unspooled() {
                        self.sites[self.site].sends(sent);
                    }
                    let frame = Bytes::from(frame);
                    self.truth.sent(&frame);
                    self.up.push((self.connection, frame));
                }
                job => self.jobs.push_back(job),
            }
        }
        done
    }

    pub(super) fn offer(&mut self) {
        self.offered += 1;
        let event = incident(&self.offered.to_string());
        self.sites[self.site].counted.all += 1;
        self.agent(|sending, now| sending.offer(&event, now));
    }

    pub(super) fn pass(&mut self, millis: i64) {
        self.now += millis;
        self.agent(|sending, now| sending.tick(now));
        self.live();
    }

    /// So much time passes that whatever the agent does next is due.
    pub(super) fn pass_to_deadline(&mut self) {
        let pause =
            self.sending.deadline().map(|deadline| (deadline - at(self.now).mono).nanos() / 1_000_000);
        self.pass(pause.unwrap_or_default().clamp(1, 20_000));
    }

    /// The live lane: a host that the aggregator forgot learns of it.
    fn live(&mut self) {
        if self.sending.is_up() {
            let reply = self.aggregator.live(self.connection, self.host, at(self.now).mono);
            self.down.extend(reply.map(|reply| (self.connection, reply)));
        }
    }

    /// The spool completes its next job, or fails to.
    pub(super) fn work(&mut self) {
        let Some(job) = self.jobs.pop_front() else { return };
        if self.broken {
            let reason = "the disk fails".to_owned();
            self.agent(|sending, now| match job {
                Action::Append { .. } => sending.append_failed(reason, now),
                Action::Load { .. } => sending.load_failed(reason, now),
                Action::Delete { .. } => sending.delete_failed(reason, now),
                Action::Renew { .. } => sending.renew_failed(reason, now),
                Action::Send(_) => unreachable!("not a job"),
            });
            return;
        }
        let loaded = self.apply(&job);
        self.agent(|sending, now| match job {
            Action::Append { .. } => drop(sending.appended(now)),
            Action::Load { .. } => drop(sending.loaded(loaded, now)),
            Action::Delete { .. } => sending.deleted(),
            Action::Renew { .. } => sending.renewed(now),
            Action::Send(_) => unreachable!("not a job"),
        });
    }

    /// What a job does to the file.
    fn apply(&mut self, job: &Action) -> Vec<SpooledBatch> {
        let file = &mut self.sites[self.site];
        match job {
            Action::Append { batches, totals } => {
                file.append(batches, totals.clone());
                batches.iter().for_each(|batch| self.truth.appended(batch));
            }
            Action::Load { from, bytes } => return file.load(*from, *bytes),
            Action::Delete { through, chain } => {
                let deleted = file.delete(*through, *chain);
                self.truth.deleted(&deleted);
            }
            Action::Renew { stream, previous, first, events_before_first } => {
                file.renew(*stream, *previous, *first, *events_before_first);
            }
            Action::Send(_) => unreachable!("not a job"),
        }
        Vec::new()
    }

    /// The next frame, or one behind it, reaches the aggregator. One that was damaged is not repeated: nothing damages
    /// several in the same way.
    pub(super) fn deliver_up(&mut self, index: usize, keep: bool) {
        if self.up.is_empty() {
            return;
        }
        let index = index % self.up.len();
        let (connection, frame) = self.up.remove(index);
        if keep && !self.truth.is_damaged(&frame) {
            self.up.insert(index, (connection, frame.clone()));
        }
        let reply = self.aggregator.frame(connection, &frame, at(self.now).mono);
        self.down.extend(reply.map(|reply| (connection, reply)));
    }

    /// The same towards the agent; what was sent to an earlier connection is lost.
    pub(super) fn deliver_down(&mut self, index: usize, keep: bool) {
        if self.down.is_empty() {
            return;
        }
        let index = index % self.down.len();
        let (connection, message) = if keep { self.down[index].clone() } else { self.down.remove(index) };
        if connection == self.connection {
            let frame = codec::encode(&message);
            let message = codec::decode(&frame).expect("our own frame");
            self.agent(|sending, now| drop(sending.received(&message, now)));
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

    /// Turns a bit of a batch under way. What says hello is not protected by a hash, nor repeated: it is left alone.
    pub(super) fn damage(&mut self, index: usize, bit: usize) {
        let batches = self.up.iter_mut().filter(|(_, frame)| codec::batch_head(frame).is_some());
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

    /// The writer commits so many works; when not `told`, the aggregator dies between commit and acknowledgement.
    pub(super) fn commit(&mut self, count: usize, told: bool) {
        let stored = self.aggregator.commit(count);
        stored.iter().for_each(|(stream, entry)| self.truth.committed(*stream, entry));
        if told {
            let replies = self.aggregator.committed(stored.into_iter().map(|(stream, _)| stream).collect());
            self.down.extend(replies);
        } else {
            self.aggregator.kill();
        }
    }

    pub(super) fn fail_commit(&mut self) {
        let replies = self.aggregator.fail();
        self.down.extend(replies);
    }

    pub(super) fn disconnect(&mut self) {
        self.connection += 1;
        self.agent(|sending, now| {
            sending.disconnected();
            sending.connected(now.mono);
        });
    }

    /// The agent is killed and started anew at a site. The disk has done `done` of its jobs, which the agent did not
    /// get to know.
    pub(super) fn start_agent(&mut self, site: usize, done: usize) {
        let jobs: Vec<Action> = self.jobs.drain(..).take(if self.broken { 0 } else { done }).collect();
        jobs.iter().for_each(|job| drop(self.apply(job)));
        self.site = site;
        self.processes += 1;
        self.connection += 1;
        let spool = self.sites[self.site].start();
        self.sending =
            Sending::new(self.config, super::host(self.host, "edge"), SECRET, self.processes, spool);
        self.agent(|sending, now| sending.connected(now.mono));
    }

    /// The spool is copied to another machine.
    pub(super) fn copy(&mut self) {
        // Shared memory is not copied with it.
        let mut copy = self.file().clone();
        copy.counted = CountedEvents::default();
        self.sites.push(copy);
        self.truth.copied = true;
    }

    /// The agent is killed, and the next machine's started, which has a copy of an older spool.
    pub(super) fn go_to_the_next(&mut self, done: usize) {
        self.start_agent((self.site + 1) % self.sites.len(), done);
    }

    /// The agent is stopped and its spool deleted.
    pub(super) fn delete_spool(&mut self) {
        self.jobs.clear();
        // Those of a dead process that come long after it would have its stream counted as one more that was left.
        self.up.retain(|(_, frame)| codec::batch_head(frame).is_some());
        let file = SpoolFile::new(StreamId::random());
        let old = std::mem::replace(&mut self.sites[self.site], file);
        self.truth.lost(&old);
        self.start_agent(self.site, 0);
    }

    pub(super) fn back_up(&mut self) {
        self.aggregator.backup = Some(self.aggregator.database.clone());
    }

    pub(super) fn restore(&mut self) {
        if let Some(backup) = self.aggregator.backup.clone() {
            self.aggregator.database = backup;
            self.truth.restored = true;
            self.aggregator.kill();
        }
    }

    /// No faults any more, until everything that any site holds is stored.
    pub(super) fn settle(&mut self) {
        self.broken = false;
        self.settle_site();
        for other in (0..self.sites.len()).filter(|other| *other != self.site).collect::<Vec<_>>() {
            self.start_agent(other, usize::MAX);
            self.settle_site();
        }
    }

    fn settle_site(&mut self) {
        let limit = self.now + PATIENCE_MS;
        self.agent(|sending, now| sending.flush(now.wall));
        for _ in 0..MOST_TURNS {
            self.live();
            while !(self.up.is_empty()
                && self.down.is_empty()
                && self.jobs.is_empty()
                && self.aggregator.is_idle())
            {
                self.deliver_up(0, false);
                self.work();
                self.commit(usize::MAX, true);
                self.deliver_down(0, false);
                self.check();
            }
            let rests = self.sending.is_idle() && self.sending.has_reported_all();
            if self.sending.is_up() && rests && self.file().batches.is_empty() {
                // Its welcome may be that of an aggregator which is no more: the live lane shows it.
                self.live();
                if self.down.is_empty() {
                    return;
                }
                continue;
            }
            self.pass_to_deadline();
            assert!(self.now < limit, "it never came to rest: {self:#?}");
        }
        panic!("it did too much without coming to rest: {self:#?}");
    }

    /// What holds at any time.
    pub(super) fn check(&self) {
        let Accounting { produced, stored, waiting, dropped, .. } = self.sending.accounting();
        assert_eq!(produced, stored + waiting + dropped, "produced = stored + waiting + dropped");
        if !self.truth.restored && !self.truth.copied {
            assert_eq!(self.aggregator.missing, 0, "batches went missing");
        }
    }

    /// What holds at rest.
    pub(super) fn check_settled(&self) {
        self.check();
        self.truth.check(&self.aggregator);
        self.truth.check_sum(self.offered, &self.aggregator);
        assert!(self.sites.iter().all(|file| file.batches.is_empty()), "everything was acknowledged");
    }
}

/// The events that the gaps in a body say are missing.
fn told(events: u32, body: &[u8]) -> u64 {
    let events = codec::events(body, events).expect("our own events");
    let count = |event| match event {
        Event::Gap(gap) => gap.count,
        _ => 0,
    };
    events.into_iter().map(count).sum()
}

/// The numbers of the events in a body, in order; gaps are left out.
fn names(events: u32, body: &[u8]) -> Vec<u64> {
    let events = codec::events(body, events).expect("our own events");
    let name = |event| match event {
        Event::Incident(incident) => Some(incident.text.parse().expect("a number")),
        _ => None,
    };
    events.into_iter().filter_map(name).collect()
}
