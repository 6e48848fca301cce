//! Agents and an aggregator for tests.

mod agent;
mod aggregator;
mod switchable_clock;

pub(crate) use agent::{StateDir, TestAgent, clock, config, faulty_clock};
pub(crate) use aggregator::{Aggregator, AggregatorBehaviour, ReceivedEvents};
pub(crate) use switchable_clock::SwitchableClock;

use std::time::Duration;

use peernet_logger::Tree;
use peernet_stream::Iteration;

/// Version that the agents of tests report.
pub(crate) const VERSION: &str = "1.2.3 (a commit)";
/// Longest wait before a test fails. No test waits this long unless something is broken.
pub(crate) const WAIT_TIMEOUT: Duration = Duration::from_secs(60);

/// Returns the value of a node directly below the root.
pub(crate) fn value(tree: &Tree, name: &str) -> Option<f64> {
    tree.find(&[name])?.1.measure.value()
}

/// Asserts that the stages and the unattributed time add up to the total.
pub(crate) fn assert_adds_up(iteration: &Iteration) {
    let tree = &iteration.tree;
    let all = ["total", "stages-total", "unattributed"].map(|name| value(tree, name));
    let [Some(total), Some(stages_total), Some(unattributed)] = all else { panic!("{all:?} in {tree:?}") };
    assert!((total - stages_total - unattributed).abs() < 1e-8, "{total} ≠ {stages_total} + {unattributed}");
    assert!(stages_total > 0.0 && unattributed >= 0.0, "{stages_total} + {unattributed}");
}

/// Asserts that iterations are numbered from 1 without gaps, in whatever order they ended.
pub(crate) fn assert_contiguous(iterations: &[&Iteration]) {
    let mut numbers: Vec<u64> = iterations.iter().map(|iteration| iteration.number).collect();
    numbers.sort_unstable();
    assert!(numbers.iter().copied().eq(1..=iterations.len() as u64), "{numbers:?}");
}
