//! Episodes, warm-up and unanswered iterations for charts of a run over time.

use peernet_clock::WallTime;

/// Episodes, warm-up and iterations without an answer of a run. Times are on the edge's wall clock. They come from stored
/// iterations, so there are no times of deleted or lost iterations.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Episodes {
    /// Start of the first iteration, if it is still stored.
    pub first: Option<WallTime>,
    /// Number of started episodes: 1 for a run that is not divided into episodes, 0 without iterations.
    pub count: u64,
    /// Number of iterations of each episode except the last; `None` if there is only one episode, or if episodes have different lengths.
    pub steps: Option<u64>,
    /// Starts of all episodes except the first. Empty if there are more than [`Episodes::MAX_BORDERS`].
    pub borders: Vec<WallTime>,
    /// Start of the first iteration after the warm-up; `None` if the run has no warm-up, or its end is not stored.
    pub warm_up_until: Option<WallTime>,
    /// Starts of iterations without an answer, including the warm-up. If there are more than [`Episodes::MAX_UNANSWERED`], the
    /// run is divided into this number of parts, and the list has the first such start of each part.
    pub unanswered_starts: Vec<WallTime>,
    /// Number of stored iterations without an answer. At most one more than [`Episodes::MAX_COUNTED`], which means "more than that".
    pub unanswered_count: u64,
}

impl Episodes {
    /// Maximum number of episodes whose borders are shown. More borders would cover the chart.
    pub const MAX_BORDERS: u32 = 30;
    /// Maximum number of unanswered iterations in a chart. More could not be distinguished.
    pub const MAX_UNANSWERED: usize = 300;
    /// Limit of the count of unanswered iterations, which bounds the time of the query in a run without any answer.
    pub const MAX_COUNTED: u64 = 10_000;
}
