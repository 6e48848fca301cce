//! From events to batches in the spool: the agent's side before anything is sent.

use std::collections::BTreeMap;

use bytes::Bytes;
use peernet_clock::{MonoTime, Stamp, WallTime};

use super::losses::Losses;
use super::spool::{Spool, SpooledBatch, Usage};
use super::{Event, Gap, SendingConfig, codec};
use crate::limits::MAX_BYTES;
use crate::{RunId, Slug};

/// Runs whose pipeline is remembered, at most: one a pipeline, and some that ended without saying so.
const MOST_RUNS: usize = 256;

/// Room that a report of a loss takes.
const GAP: Usage = Usage { events: 1, bytes: 512 };

/// Longest event: the largest tree and what surrounds it.
const MAX_EVENT_BYTES: usize = MAX_BYTES + 16 * 1024;

/// Takes events, counts them, cuts them into batches, and hands those to the spool.
#[derive(Debug)]
pub(super) struct Intake<S> {
    config: SendingConfig,
    pub(super) spool: S,
    pub(super) offered: u64,
    pub(super) dropped: u64,
    open: OpenBatch,
    /// The event at hand, encoded; kept to reuse its memory.
    encoded: Vec<u8>,
    losses: Losses,
    /// Pipelines of the runs under way: an iteration names its run only.
    pipelines: BTreeMap<RunId, Slug>,
}

/// A batch under construction.
#[derive(Debug, Default)]
struct OpenBatch {
    body: Vec<u8>,
    events: u32,
    nodes: usize,
    since: MonoTime,
}

impl<S: Spool> Intake<S> {
    pub(super) fn new(config: SendingConfig, spool: S) -> Self {
        Self {
            config,
            offered: spool.usage().events,
            dropped: 0,
            spool,
            open: OpenBatch::default(),
            encoded: Vec::new(),
            losses: Losses::default(),
            pipelines: BTreeMap::new(),
        }
    }

    pub(super) fn offer(&mut self, event: &Event, now: Stamp) {
        self.offered += 1;
        self.encoded.clear();
        codec::append(&mut self.encoded, event);
        match self.refusal(event) {
            None => {
                self.report_losses(now);
                if let Event::RunEnded(ended) = event {
                    self.report_ended(Some(ended.run), now);
                }
                self.take(weight(event), now);
            }
            Some(reason) => {
                self.dropped += 1;
                let (pipeline, run) = self.scope(event);
                self.losses.add(pipeline, run, now, 1, reason);
            }
        }
        self.remember(event);
    }

    /// Why the event at hand cannot be taken.
    fn refusal(&self, event: &Event) -> Option<String> {
        let mut more = Usage { events: 1, bytes: self.encoded.len() as u64 };
        if let Event::Iteration(iteration) = event {
            // One that the aggregator would refuse must not hold up everything behind it.
            if let Err(error) = iteration.tree.check(0) {
                return Some(format!("the iteration cannot be sent: {error}"));
            }
            more.events += self.config.reserve_events;
        }
        if self.encoded.len() > MAX_EVENT_BYTES {
            return Some(format!("the event is longer than {MAX_EVENT_BYTES} bytes"));
        }
        let fits = self.spool.fits(self.open_usage() + more + self.reports());
        (!fits).then(|| "the agent's spool was full".to_owned())
    }

    /// Puts gaps that are due where the lost events would have been, if there is room.
    pub(super) fn report_losses(&mut self, now: Stamp) {
        if self.has_room_for_reports() {
            let gaps = self.losses.take_due(now.mono);
            self.report(gaps, now);
        }
    }

    /// The same for all losses of a run that ends, or of all that end.
    fn report_ended(&mut self, run: Option<RunId>, now: Stamp) {
        if self.has_room_for_reports() {
            let gaps = self.losses.take_ended(run, now.mono);
            self.report(gaps, now);
        }
    }

    fn has_room_for_reports(&self) -> bool {
        self.losses.len() > 0 && self.spool.fits(self.open_usage() + self.reports())
    }

    fn report(&mut self, gaps: Vec<Gap>, now: Stamp) {
        let event = std::mem::take(&mut self.encoded);
        for gap in gaps {
            self.offered += 1;
            self.encoded.clear();
            codec::append(&mut self.encoded, &Event::Gap(gap));
            self.take(1, now);
        }
        self.encoded = event;
    }

    /// Adds the event at hand to the batch.
    fn take(&mut self, nodes: usize, now: Stamp) {
        let full = self.open.body.len() + self.encoded.len() > self.config.batch_bytes
            || self.open.nodes + nodes > self.config.batch_nodes;
        if full {
            self.cut(now);
        }
        if self.open.events == 0 {
            self.open.since = now.mono;
        }
        self.open.body.extend_from_slice(&self.encoded);
        self.open.events += 1;
        self.open.nodes += nodes;
    }

    /// Reports what is not reported yet and hands everything to the spool: before a stop.
    pub(super) fn flush(&mut self, now: WallTime) {
        // The age of the batch does not matter: it is cut at once.
        let now = Stamp { wall: now, mono: self.open.since };
        self.report_ended(None, now);
        self.cut(now);
    }

    /// Hands the batch under construction to the spool.
    pub(super) fn cut(&mut self, now: Stamp) {
        let OpenBatch { body, events, .. } = std::mem::take(&mut self.open);
        if events == 0 {
            return;
        }
        if let Err(error) = self.spool.append(SpooledBatch { events, body: Bytes::from(body) }) {
            self.dropped += u64::from(events);
            self.losses.add(None, None, now, u64::from(events), error.to_string());
        }
    }

    pub(super) fn tick(&mut self, now: Stamp) {
        if self.batch_deadline().is_some_and(|deadline| now.mono >= deadline) {
            self.cut(now);
        }
        self.report_losses(now);
    }

    /// When the batch under construction is old enough, or a loss is to be reported.
    pub(super) fn deadline(&self) -> Option<MonoTime> {
        let batch = self.batch_deadline();
        // Without room there is nothing to do: an acknowledgement makes some.
        let report = self.has_room_for_reports().then(|| self.losses.due()).flatten();
        batch.into_iter().chain(report).min()
    }

    fn batch_deadline(&self) -> Option<MonoTime> {
        (self.open.events > 0).then(|| self.open.since + self.config.batch_age)
    }

    /// What is not stored over there yet.
    pub(super) fn waiting(&self) -> Usage {
        self.spool.usage() + self.open_usage()
    }

    fn open_usage(&self) -> Usage {
        Usage { events: u64::from(self.open.events), bytes: self.open.body.len() as u64 }
    }

    /// Room for what there is to report.
    fn reports(&self) -> Usage {
        let gaps = self.losses.len() as u64;
        Usage { events: gaps * GAP.events, bytes: gaps * GAP.bytes }
    }

    /// The pipeline and run that an event concerns.
    fn scope(&self, event: &Event) -> (Option<Slug>, Option<RunId>) {
        let of_run = |run: &RunId| (self.pipelines.get(run).cloned(), Some(*run));
        match event {
            Event::RunStarted(started) => (Some(started.pipeline.clone()), Some(started.run)),
            Event::RunEnded(ended) => of_run(&ended.run),
            Event::Iteration(iteration) => of_run(&iteration.run),
            Event::Incident(incident) => (incident.pipeline.clone(), incident.run),
            Event::Gap(gap) => (gap.pipeline.clone(), gap.run),
            Event::Clock(_) => (None, None),
        }
    }

    fn remember(&mut self, event: &Event) {
        match event {
            Event::RunStarted(started) => {
                if self.pipelines.len() >= MOST_RUNS {
                    self.pipelines.pop_first();
                }
                self.pipelines.insert(started.run, started.pipeline.clone());
            }
            Event::RunEnded(ended) => {
                self.pipelines.remove(&ended.run);
            }
            _ => {}
        }
    }
}

/// What an event counts when batches are cut by nodes.
fn weight(event: &Event) -> usize {
    match event {
        Event::Iteration(iteration) => iteration.tree.nodes().len(),
        _ => 1,
    }
}
