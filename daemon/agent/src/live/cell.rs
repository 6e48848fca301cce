//! The statistics of one second.

use peernet_clock::Interval;
use peernet_logger::{Measure, Name, Node, Tree};
use peernet_statistics::Summary;
use peernet_stream::{Outcome, OutcomeCounts, Second};

/// 1 where the iteration took longer than the deadline of its pipeline or has no answer, else 0. Absent without a deadline.
pub(crate) const DEADLINE_MISSED: Name = Name::from_static("deadline-missed");

/// Names per second at most: a peer adds nodes of its own choice, and the memory for them must be bounded.
const MOST_NAMES: usize = 64;

/// One second of one pipeline.
#[derive(Debug)]
pub(super) struct Cell {
    pub(super) at: i64,
    /// Rises with every change of the ring; a receiver has seen the cell up to `shown`.
    pub(super) version: u64,
    pub(super) shown: u64,
    counts: OutcomeCounts,
    values: Summaries,
    bounds: Summaries,
    verdicts: Vec<(Name, Name, u64)>,
}

impl Cell {
    pub(super) const fn new(at: i64) -> Self {
        Self {
            at,
            version: 0,
            shown: 0,
            counts: OutcomeCounts { ok: 0, failed: 0, lost: 0, timeout: 0 },
            values: Summaries(Vec::new()),
            bounds: Summaries(Vec::new()),
            verdicts: Vec::new(),
        }
    }

    /// Adds an iteration that is not warm-up.
    pub(super) fn record(&mut self, outcome: &Outcome, tree: &Tree) {
        match outcome {
            Outcome::Ok => self.counts.ok += 1,
            Outcome::Failed(_) => self.counts.failed += 1,
            Outcome::Lost(_) => self.counts.lost += 1,
            Outcome::Timeout => self.counts.timeout += 1,
        }
        // What a failed one took says nothing of how long a working one takes. That its pipeline has a deadline is told by
        // the name alone: a second without any answer would say nothing of it.
        if *outcome != Outcome::Ok {
            if tree.find(&[DEADLINE_MISSED.as_str()]).is_some() {
                self.values.open(0, &DEADLINE_MISSED);
            }
            return;
        }
        let mut hint = 0;
        for node in tree.nodes() {
            if let Some(value) = node.measure.value() {
                hint = self.values.record(hint, &node.name, value);
            }
            self.judge(node);
        }
    }

    /// Adds what is known of the clocks to a message's way.
    fn judge(&mut self, node: &Node) {
        let Measure::Transit(transit) = &node.measure else { return };
        let Some(delay) = transit.delay else { return };
        // What has no value is not averaged in, its error bar neither.
        if let Some(bounds) = delay.bounds.filter(|_| delay.value.is_some()) {
            self.bounds.record(0, &node.name, half_width(bounds));
        }
        let verdict = delay.verdict.name();
        let known = self.verdicts.iter_mut().find(|(name, given, _)| *name == node.name && *given == verdict);
        if let Some((_, _, count)) = known {
            *count += 1;
        } else if self.verdicts.len() < MOST_NAMES {
            self.verdicts.push((node.name.clone(), Name::from_static(verdict), 1));
        }
    }

    /// The second as it is sent.
    pub(super) fn second(&self) -> Second {
        Second {
            at: self.at,
            counts: self.counts,
            values: self.values.0.clone(),
            bounds: self.bounds.0.clone(),
            verdicts: self.verdicts.clone(),
        }
    }
}

/// Half the width of a bound, in seconds: the ± of a delay.
fn half_width(bounds: Interval) -> f64 {
    bounds.width().seconds() / 2.0
}

/// Summaries by name, in the order in which the names came up.
#[derive(Debug)]
struct Summaries(Vec<(Name, Summary)>);

impl Summaries {
    /// Adds a value and returns where the next name probably stands: trees of one pipeline have their nodes
    /// in the same order nearly always, so that a name is found at the first look.
    fn record(&mut self, hint: usize, name: &Name, value: f64) -> usize {
        let Some(index) = self.open(hint, name) else { return hint };
        self.0[index].1.record(value);
        index + 1
    }

    /// The place of a name, which is added when it is new; `None` where there is no room for it.
    fn open(&mut self, hint: usize, name: &Name) -> Option<usize> {
        let found = match self.0.get(hint) {
            Some((known, _)) if known == name => Some(hint),
            _ => self.0.iter().position(|(known, _)| known == name),
        };
        if found.is_none() && self.0.len() < MOST_NAMES {
            self.0.push((name.clone(), Summary::default()));
            return Some(self.0.len() - 1);
        }
        found
    }
}
