//! Two quantities of single iterations.

/// Two quantities of some of a run's iterations. Successful ones only, warm-up left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pairs {
    /// Both quantities of each iteration that has them, in SI units, by rising number.
    pub points: Vec<(f64, f64)>,
    /// How many iterations were looked at, of whatever kind.
    pub asked: u64,
    /// How many are stored, by their numbers: what retention deleted is not among them.
    pub of: u64,
}

impl Pairs {
    /// Whether all that are stored were looked at.
    pub const fn is_whole(&self) -> bool {
        self.asked >= self.of
    }
}
