//! Episodes, warm-up and failed iterations for charts of a run over time.

use peernet_analysis::warm_up::MAX_EPISODE_BORDERS;
use peernet_clock::WallTime;

/// Episodes, warm-up and failed iterations of a run. Times are on the edge's wall clock. Iterations that retention
/// deleted, or that never reached the store, have no times.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Episodes {
    /// Start of the run's first iteration, if this iteration is still stored.
    pub first: Option<WallTime>,
    /// Number of started episodes: 1 for a run that is not divided into episodes, 0 without iterations.
    pub count: u64,
    /// Number of iterations of each episode except the last; `None` if there is only one episode, or if episodes have
    /// different lengths.
    pub steps: Option<u64>,
    /// Starts of all episodes except the first. Empty if there are more than [`Episodes::MAX_BORDERS`].
    pub borders: Vec<WallTime>,
    /// Periods of warm-up at the start of the run and of each episode in `borders`. A period begins with the first
    /// iteration of the episode. It ends with the start of the next iteration that is not warm-up or, if there is none,
    /// with the start of the last iteration. Periods whose beginning or end is not stored are left out.
    pub warm_up: Vec<(WallTime, WallTime)>,
    /// Starts of failed iterations, including the warm-up. If there are more than [`Episodes::MAX_FAILED`] failed
    /// iterations, the run is divided into this number of parts, and the list has the first failed iteration of each
    /// part.
    pub failed_starts: Vec<WallTime>,
    /// Number of stored failed iterations of the warm-up; `None` if more than [`Episodes::MAX_COUNTED`] failed
    /// iterations are stored.
    pub failed_in_warm_up: Option<u64>,
}

impl Episodes {
    /// Maximum number of borders that are read, because a chart shows no more.
    pub const MAX_BORDERS: u32 = MAX_EPISODE_BORDERS;
    /// Maximum number of failed iterations that a chart marks. A reader could not distinguish more marks.
    pub const MAX_FAILED: usize = 300;
    /// Number up to which failed iterations are counted. It limits the time of the query for a run in which every
    /// iteration failed.
    pub const MAX_COUNTED: u64 = 10_000;
}
