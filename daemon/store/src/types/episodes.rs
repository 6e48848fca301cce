//! What stands beside the course of a run over time.

use peernet_clock::WallTime;

/// Episodes, warm-up and iterations without an answer of a run. Moments are on the edge's wall clock, and those of
/// stored iterations: what retention deleted or the way lost has none.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Episodes {
    /// When the first iteration began, where it is still stored.
    pub first: Option<WallTime>,
    /// Episodes that began; 1 as well where a run is not parted into any, 0 without iterations.
    pub count: u64,
    /// Iterations of each but the last; `None` where there is but one.
    pub steps: Option<u64>,
    /// When episodes began, but for the first. Empty where there are more than [`Episodes::MOST_BORDERS`].
    pub borders: Vec<WallTime>,
    /// When the first iteration began that is not of the warm-up; `None` where nothing shows it.
    pub warm_up_until: Option<WallTime>,
    /// When iterations without an answer began, those of the warm-up included: all of them, or where there are more than
    /// [`Episodes::MOST_UNANSWERED`] the first of each of as many parts of the run.
    pub unanswered: Vec<WallTime>,
    /// How many of those are stored, of which `unanswered` are all or some; one more than [`Episodes::MOST_COUNTED`] where
    /// there are more than that.
    pub without_answer: u64,
}

impl Episodes {
    /// With more their borders would be all that is seen.
    pub const MOST_BORDERS: u32 = 30;
    /// More than anybody can tell apart in a picture.
    pub const MOST_UNANSWERED: usize = 300;
    /// So that the count takes no longer for a run in which nothing was ever answered.
    pub const MOST_COUNTED: u64 = 10_000;
}
