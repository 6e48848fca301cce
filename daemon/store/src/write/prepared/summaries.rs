//! Values that a batch adds to the statistics, by the second in which the iterations began.

use std::collections::HashMap;

use peernet_statistics::Summary;

use crate::rollups::Quantity;

/// Summary of one quantity in one second.
#[derive(Debug)]
pub(in crate::write) struct SummaryPart {
    /// Position in the batch's runs.
    pub(in crate::write) run: u32,
    /// Position in the batch's names.
    pub(in crate::write) name: u32,
    pub(in crate::write) quantity: Quantity,
    /// Second of the iteration's start, since 1970 on the edge's clock.
    pub(in crate::write) second_s: i64,
    pub(in crate::write) summary: Summary,
}

/// The statistics of a batch.
#[derive(Debug, Default)]
pub(super) struct Summaries {
    pub(super) list: Vec<SummaryPart>,
    /// Position in `list`, by run, name, quantity and second.
    positions: HashMap<(u32, u32, Quantity, i64), usize>,
    /// Position in `list` of the summary to which a value was added last, by name and quantity. The next value mostly
    /// belongs to the same run and second.
    last_positions: Vec<[usize; Quantity::COUNT]>,
}

impl Summaries {
    /// Adds a value of an iteration that began in `second_s`. Values that a summary does not accept are omitted.
    pub(super) fn record(&mut self, run: u32, name: u32, quantity: Quantity, second_s: i64, value: f64) {
        if !Summary::accepts(value) {
            return;
        }
        if self.last_positions.len() <= name as usize {
            // `usize::MAX` means that the name has no summary of the quantity yet.
            self.last_positions.resize(name as usize + 1, [usize::MAX; Quantity::COUNT]);
        }
        let last_position = &mut self.last_positions[name as usize][quantity as usize];
        if let Some(part) = self.list.get_mut(*last_position)
            && (part.run, part.second_s) == (run, second_s)
        {
            part.summary.record(value);
            return;
        }
        *last_position = *self.positions.entry((run, name, quantity, second_s)).or_insert_with(|| {
            self.list.push(SummaryPart { run, name, quantity, second_s, summary: Summary::default() });
            self.list.len() - 1
        });
        self.list[*last_position].summary.record(value);
    }
}
