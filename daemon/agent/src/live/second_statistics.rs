//! The statistics of one second.

use peernet_analysis::actuator_results::is_value_in_statistics;
use peernet_analysis::deadline::DEADLINE_MISSED;
use peernet_analysis::delays::VerdictCounts;
use peernet_analysis::outcomes::Counts;
use peernet_analysis::transfer::{DirectionNodes, direction_of_delay};
use peernet_clock::{Direction, Span};
use peernet_logger::{Measure, Name, Node, Tree, stage};
use peernet_statistics::Summary;
use peernet_stream::{Outcome, Second, bound_names};

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
    /// Number of delays by verdict, in the order of [`Direction::ALL`].
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

    /// Adds an iteration.
    pub(super) fn record(&mut self, outcome: &Outcome, warm_up: bool, tree: &Tree) {
        self.counts.add(outcome, warm_up);
        let is_in_statistics = *outcome == Outcome::Ok && !warm_up;
        // Probable index of the next name in `values`.
        let mut hint = 0;
        for (_, node, value) in tree.counted_nodes().iter() {
            let name = &node.name;
            // Skipped starts do not depend on the answer, so they count for iterations that failed, too.
            let is_counted =
                is_value_in_statistics(name, is_in_statistics) || !warm_up && *name == stage::SKIPPED_STARTS;
            if is_counted && let Some(value) = value {
                hint = self.values.record(hint, name, value);
            } else if !warm_up && *name == DEADLINE_MISSED {
                // The name without a value shows that there is a deadline, even in a second without answers.
                self.values.find_or_add(hint, name);
            }
            if is_in_statistics {
                self.record_delay(node);
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
        if let Some(direction) = direction_of_delay(&node.name) {
            self.verdicts[direction as usize].add(delay.verdict, 1);
        }
    }

    /// Returns the second in the form in which it is sent.
    pub(super) fn to_message(&self) -> Second {
        let verdicts = Direction::ALL.into_iter().zip(self.verdicts).flat_map(|(direction, verdicts)| {
            let delay = &DirectionNodes::of(direction).delay;
            let counts = verdicts.counts();
            counts.map(move |(verdict, count)| (delay.clone(), Name::from_static(verdict.name()), count))
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

/// Returns whether an iteration of the warm-up has a value that statistics include: the result of an episode.
pub(super) fn has_episode_result(tree: &Tree) -> bool {
    let (nodes, is_in_statistics) = (tree.counted_nodes(), false);
    nodes
        .iter()
        .any(|(_, node, value)| value.is_some() && is_value_in_statistics(&node.name, is_in_statistics))
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
