//! Pairs of quantities of single iterations.

/// Two quantities of some iterations of a run. Only successful iterations after the warm-up have points.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ValuePairs {
    /// Both quantities of each iteration that has them, in SI units, in the order of the iterations.
    pub points: Vec<(f64, f64)>,
    /// Number of iteration numbers that were read. Not every number has a stored iteration, because iterations may be
    /// lost.
    pub read_iterations: u64,
    /// Number of iteration numbers from the first to the last stored iteration.
    pub stored_iterations: u64,
}

impl ValuePairs {
    /// Returns whether all stored iterations were read.
    pub const fn is_complete(&self) -> bool {
        self.read_iterations >= self.stored_iterations
    }
}
