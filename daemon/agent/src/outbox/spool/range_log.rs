//! Logs which iterations are in the spool. After a crash, tests compare these log lines with the aggregator's database.

use std::collections::BTreeMap;

use peernet_logger::RunId;
use peernet_stream::{Event, SpooledBatch, codec};
use tracing::Level;

/// Target of these log lines.
const TARGET: &str = "peernet_agent::outbox::spool";

/// Logs the iterations of batches that are in the spool: one line per batch, run and contiguous range of numbers.
pub(super) fn log_ranges(batches: &[SpooledBatch]) {
    // Decoding all batches takes time, so the batches are decoded only if the lines are logged.
    if !tracing::enabled!(target: TARGET, Level::DEBUG) {
        return;
    }
    for batch in batches {
        for (run, first, last) in iteration_ranges(batch) {
            let count = last - first + 1;
            tracing::debug!(target: TARGET, batch = batch.number, %run, first, last, count, "spooled");
        }
    }
}

/// Returns the numbers of a batch's iterations as contiguous ranges: the run, the first and the last number.
pub(super) fn iteration_ranges(batch: &SpooledBatch) -> Vec<(RunId, u64, u64)> {
    let events = match codec::decode_events(&batch.body, batch.events) {
        Ok(events) => events,
        Err(error) => {
            tracing::debug!(target: TARGET, batch = batch.number, %error, "cannot decode a spooled batch");
            return Vec::new();
        }
    };
    let mut runs: BTreeMap<RunId, Vec<u64>> = BTreeMap::new();
    for event in events {
        if let Event::Iteration(iteration) = event {
            runs.entry(iteration.run).or_default().push(iteration.number);
        }
    }
    let mut ranges = Vec::new();
    for (run, mut numbers) in runs {
        numbers.sort_unstable();
        for number in numbers {
            match ranges.last_mut() {
                Some((other_run, _, last)) if *other_run == run && *last + 1 == number => *last = number,
                _ => ranges.push((run, number, number)),
            }
        }
    }
    ranges
}
