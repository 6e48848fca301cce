//! The statistics of one second.

use peernet_analysis::delays::VerdictCounts;
use peernet_analysis::outcomes::Counts;
use peernet_clock::Span;
use peernet_logger::{Measure, Name, Node, Tree, stage};
use peernet_statistics::Summary;
use peernet_stream::{Outcome, Second, bound_names};

/// Name of the value that is 1 if an iteration missed its deadline or failed, and 0 otherwise. Absent if the
/// pipeline has no deadline.
pub(crate) const DEADLINE_MISSED: Name = Name::from_static("deadline-missed");

/// Name of the value that is 1 if the episode that ended with an iteration was a success, else 0. It belongs to the
/// episode, so it counts even if the last answer of the episode is lost, and if the episode ends within its warm-up.
pub(crate) const EPISODE_SUCCESS: Name = Name::from_static("episode-success");
/// Name of the return of the episode that ended with an iteration: the sum of its rewards. It counts in the same cases
/// as [`EPISODE_SUCCESS`].
pub(crate) const EPISODE_RETURN: Name = Name::from_static("episode-return");

/// Stages whose delays have verdicts.
const DIRECTIONS: [Name; 2] = [stage::UPLOAD, stage::DOWNLOAD];

/// Maximum number of names per second.
// A peer adds nodes of its choice to a tree, so the memory for their names must be bounded.
const MAX_NAMES: usize = 64;

/// Statistics of one second of one pipeline.
#[derive(Debug)]
pub(super) struct SecondStatistics {
    /// Start in seconds since the Unix epoch.
    pub(super) at: i64,
    /// Version of the ring at the last change of this second.
    pub(super) version: u64,
    /// Version of this second that was last sent.
    pub(super) sent_version: u64,
    counts: Counts,
    /// Values of the nodes by name.
    values: Summaries,
    /// Half the widths of the intervals of delays, and the ends of the intervals, by name.
    bounds: Summaries,
    /// Number of delays by verdict, in the order of [`DIRECTIONS`].
    verdicts: [VerdictCounts; 2],
}

impl SecondStatistics {
    pub(super) fn new(at: i64) -> Self {
        Self {
            at,
            version: 0,
            sent_version: 0,
            counts: Counts::default(),
            values: Summaries(Vec::new()),
            bounds: Summaries(Vec::new()),
            verdicts: [VerdictCounts::default(); 2],
        }
    }

    /// Adds an iteration that is not warm-up.
    pub(super) fn record(&mut self, outcome: &Outcome, tree: &Tree) {
        self.counts.add(outcome, false);
        // The durations of a failed iteration are left out, because they say nothing about the durations of successful
        // iterations. The name of the deadline's value is added, so that a second without answers still shows that
        // there is a deadline. Values that do not depend on the answer are added, too: skipped starts and the results
        // of an episode.
        if *outcome != Outcome::Ok {
            if tree.find(&[DEADLINE_MISSED.as_str()]).is_some() {
                self.values.find_or_add(0, &DEADLINE_MISSED);
            }
            if let Some(value) = value_of(tree, &stage::SKIPPED_STARTS) {
                self.values.record(0, &stage::SKIPPED_STARTS, value);
            }
            self.record_episode_result(tree);
            return;
        }
        let mut hint = 0;
        for (_, node, value) in tree.counted_nodes().iter() {
            if let Some(value) = value {
                hint = self.values.record(hint, &node.name, value);
            }
            self.record_delay(node);
        }
    }

    /// Adds the result of the episode that ended with an iteration, if one did.
    pub(super) fn record_episode_result(&mut self, tree: &Tree) {
        for name in [EPISODE_SUCCESS, EPISODE_RETURN] {
            if let Some(value) = value_of(tree, &name) {
                self.values.record(0, &name, value);
            }
        }
    }

    /// Adds verdict and bounds of the one-way delay of a node, if it has one.
    fn record_delay(&mut self, node: &Node) {
        let Measure::Transit(transit) = &node.measure else { return };
        let Some(delay) = transit.delay else { return };
        if let Some(half_width) = delay.half_width() {
            self.bounds.record(0, &node.name, half_width);
            if let (Some(names), Some(bounds)) = (bound_names(&node.name), delay.bounds) {
                let ends = [bounds.lo, bounds.hi].map(Span::seconds);
                names.iter().zip(ends).for_each(|(name, end)| {
                    self.bounds.record(0, name, end);
                });
            }
        }
        if let Some(direction) = DIRECTIONS.iter().position(|direction| *direction == node.name) {
            self.verdicts[direction].add(delay.verdict, 1);
        }
    }

    /// Returns the second in the form in which it is sent.
    pub(super) fn to_message(&self) -> Second {
        let verdicts = DIRECTIONS.into_iter().zip(self.verdicts).flat_map(|(direction, verdicts)| {
            let counts = verdicts.counts();
            counts.map(move |(verdict, count)| (direction.clone(), Name::from_static(verdict.name()), count))
        });
        Second {
            at: self.at,
            counts: self.counts.outcomes(),
            values: self.values.0.clone(),
            bounds: self.bounds.0.clone(),
            verdicts: verdicts.collect(),
        }
    }
}

/// Returns whether an episode ended with an iteration.
pub(super) fn has_episode_result(tree: &Tree) -> bool {
    [EPISODE_SUCCESS, EPISODE_RETURN].iter().any(|name| value_of(tree, name).is_some())
}

fn value_of(tree: &Tree, name: &Name) -> Option<f64> {
    tree.find(&[name.as_str()])?.1.measure.value()
}

/// Summaries by name, in the order in which the names first occurred.
#[derive(Debug)]
struct Summaries(Vec<(Name, Summary)>);

impl Summaries {
    /// Adds a value. Returns the probable index of the next name, which is the `hint` of the next call.
    // The trees of a pipeline nearly always have their nodes in the same order, so the first comparison finds the name.
    fn record(&mut self, hint: usize, name: &Name, value: f64) -> usize {
        let Some(index) = self.find_or_add(hint, name) else { return hint };
        self.0[index].1.record(value);
        index + 1
    }

    /// Returns the index of a name. Adds a new name; returns `None` if there are [`MAX_NAMES`] names already.
    fn find_or_add(&mut self, hint: usize, name: &Name) -> Option<usize> {
        let index = match self.0.get(hint) {
            Some((existing_name, _)) if existing_name == name => Some(hint),
            _ => self.0.iter().position(|(existing_name, _)| existing_name == name),
        };
        if index.is_none() && self.0.len() < MAX_NAMES {
            self.0.push((name.clone(), Summary::default()));
            return Some(self.0.len() - 1);
        }
        index
    }
}
