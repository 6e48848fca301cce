//! Reading the spool: ahead of the sending, for a comparison, and past a hole.

use peernet_clock::{MonoTime, Stamp};

use super::super::Chain;
use super::super::spool::{SpooledBatch, Usage};
use super::link::Link;
use super::spooling::Loading;
use super::{Action, Sending};

/// What the batches take that were read without being kept, and the chain of the last.
pub(super) type Skimmed = (Usage, Chain);

/// Batches in the file that are read to be compared and counted, from the first that is not in memory.
#[derive(Clone, Copy, Debug)]
pub(super) struct Skim {
    /// The next.
    at: u64,
    /// The last.
    through: u64,
    usage: Usage,
    /// Chain of the last.
    chain: Option<Chain>,
}

/// Batches that the file should hold and does not: somebody deleted them, or the medium failed.
///
/// The one behind them goes with them. Its own chain can no longer be checked by anyone, because that of the batch
/// before it is not known; but it gives the chain before the next one. The stream goes on from there, the hello says
/// so, and the aggregator records what is missing.
#[derive(Clone, Copy, Debug)]
pub(super) enum Hole {
    /// Its end is searched for here.
    Open(u64),
    /// The first batch behind it that can be sent, and the chain of the one before.
    Ends(u64, Chain),
}

impl Skim {
    pub(super) fn new(at: u64, through: u64) -> Self {
        Self { at, through, usage: Usage::default(), chain: None }
    }
}

impl Sending {
    /// What is to be read from the spool now.
    pub(super) fn load(&mut self, now: MonoTime) -> Option<Action> {
        if !self.spooling.load.is_free(now) {
            return None;
        }
        let part = self.backlog.part_bytes();
        let (loading, from, bytes) = match (&self.link, self.hole) {
            (Link::Comparing { skim, .. }, _) => (Loading::Skim(skim.at), skim.at, part),
            (_, Some(Hole::Open(at))) => (Loading::Probe(at), at, 1),
            (_, Some(Hole::Ends(..))) => return None,
            (Link::Down, None) => return None,
            _ => {
                let from = self.backlog.unknown();
                self.backlog.wants_more().then_some((Loading::Ahead(from), from, part))?
            }
        };
        self.spooling.load.begin(loading);
        Some(Action::Load { from, bytes })
    }

    /// Batches came that are to be sent.
    pub(super) fn read_ahead(&mut self, from: u64, batches: Vec<SpooledBatch>, now: Stamp) {
        let expected = from == self.backlog.unknown() && from <= self.backlog.spooled();
        // Stored over there meanwhile, or about to be counted.
        if !expected || matches!(self.link, Link::Comparing { .. }) {
            return;
        }
        if self.backlog.loaded(batches) == 0 {
            self.hole = Some(Hole::Open(from + 1));
            self.probed_past_end(now);
        }
        self.settle(now);
    }

    /// Batches came that are to be counted.
    pub(super) fn skimmed(&mut self, from: u64, batches: &[SpooledBatch], now: Stamp) {
        let Link::Comparing { skim, .. } = &mut self.link else { return };
        if skim.at != from {
            return;
        }
        for batch in batches.iter().filter(|batch| batch.number <= skim.through) {
            if batch.number < skim.at {
                continue;
            }
            skim.usage = skim.usage + batch.usage();
            skim.chain = (batch.number == skim.through).then_some(batch.chain);
            skim.at = batch.number + 1;
        }
        if skim.at == from {
            // It is missing: the one behind it may be there.
            skim.at += 1;
        }
        if skim.at <= skim.through {
            return;
        }
        let (skim, Link::Comparing { then, .. }) = (*skim, std::mem::replace(&mut self.link, Link::Down))
        else {
            return;
        };
        let skimmed = skim.chain.map(|chain| (skim.usage, chain));
        self.compared(skim.through, skimmed, then, now);
    }

    /// What was found behind a hole.
    pub(super) fn probed(&mut self, from: u64, batches: &[SpooledBatch], now: Stamp) {
        if !matches!(self.hole, Some(Hole::Open(at)) if at == from) {
            return;
        }
        let found = batches.first().filter(|batch| (from..=self.backlog.spooled()).contains(&batch.number));
        self.hole = Some(match found {
            Some(batch) => Hole::Ends(batch.number + 1, batch.chain),
            None => Hole::Open(from + 1),
        });
        self.probed_past_end(now);
        self.pass_hole(now);
    }

    /// A hole that nothing is behind ends with what is in the file.
    fn probed_past_end(&mut self, now: Stamp) {
        let spooled = self.backlog.spooled();
        if let Some(Hole::Open(at)) = self.hole
            && at > spooled
            && let Some(chain) = self.backlog.chain(spooled)
        {
            self.hole = Some(Hole::Ends(spooled + 1, chain));
            self.pass_hole(now);
        }
    }

    /// Goes on behind a hole when everything before it is stored over there.
    pub(super) fn pass_hole(&mut self, now: Stamp) {
        let Some(Hole::Ends(resume, before)) = self.hole else { return };
        if self.backlog.unknown() != self.backlog.oldest() || matches!(self.link, Link::Comparing { .. }) {
            return;
        }
        self.hole = None;
        self.backlog.skip_to(resume, before);
        self.spooling.skipped(now.mono);
        if matches!(self.link, Link::Up { .. }) {
            self.greet_again(now.mono);
        }
        self.settle(now);
    }

    /// Counts what is not in the file although it was said to be.
    fn settle(&mut self, now: Stamp) {
        let missing = self.backlog.settle();
        if missing.events > 0 {
            self.spooling.vanished(missing.bytes);
            let reason = "batches were missing from the agent's spool file".to_owned();
            self.intake.lose((None, None), missing.events, reason, now);
            let room = self.room();
            self.intake.report_losses(&room, now);
            self.number();
        }
    }

    /// The chain of a batch and what the batches up to it take that are in the file only; `None` when the file must be
    /// asked.
    pub(super) fn known(&self, number: u64) -> Option<(Chain, Option<Skimmed>)> {
        let chain = self.backlog.chain(number)?;
        if number < self.backlog.unknown() || self.backlog.unknown() > self.backlog.spooled() {
            return Some((chain, None));
        }
        let all = (number >= self.backlog.spooled()).then(|| self.backlog.filed());
        let last = self.backlog.chain(self.backlog.spooled())?;
        Some((chain, Some((all?, last))))
    }

    /// What is to be read for `known` to be answered; nothing when it is.
    pub(super) fn skim_to(&self, number: u64) -> Skim {
        Skim::new(self.backlog.unknown(), number.min(self.backlog.spooled()))
    }
}
