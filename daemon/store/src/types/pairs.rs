//! Pairs of quantities of single iterations.

/// Two quantities of some of a run's iterations. Successful ones only, without the warm-up.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pairs {
    /// Both quantities of each iteration that has them, in SI units, by ascending number.
    pub points: Vec<(f64, f64)>,
    /// Number of iterations of any kind that were read.
    pub asked: u64,
    /// Number of stored iterations; deleted ones are not counted.
    pub of: u64,
}

impl Pairs {
    /// Returns whether all stored iterations were read.
    pub const fn is_whole(&self) -> bool {
        self.asked >= self.of
    }
}
