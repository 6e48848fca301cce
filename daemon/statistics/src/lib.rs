//! Statistics of a stream of numbers in bounded memory.
//!
//! [`Moments`] are count, mean, variance and extremes, computed without loss of precision. [`Sketch`] is a
//! mergeable quantile sketch with a guaranteed error. [`Summary`] combines moments and sketch. [`RecentSeconds`] is a
//! ring of one-second cells.
//! [`histogram`] computes the range and the bins of a histogram. [`TwoModes`] is the result of a test for two modes.
//! [`mean_rate`] and [`remaining_seconds`] describe the progress of work. [`number`] formats numbers for people.
//! [`SplitMix64`] generates reproducible random numbers.
//!
//! All statistics can be merged. The merged statistics of several hosts, seconds or buckets equal the statistics of all
//! their numbers together. [`Moments`] and [`Sketch`] are sent in live updates and stored. Both are checked when they
//! are deserialised.

pub mod histogram;
mod merge;
mod modality;
mod moments;
pub mod number;
mod progress;
mod recent_seconds;
mod sketch;
mod splitmix;
mod summary;

pub use merge::Merge;
pub use modality::TwoModes;
pub use moments::Moments;
pub use progress::{mean_rate, remaining_seconds};
pub use recent_seconds::RecentSeconds;
pub use sketch::{PackedError, Sketch};
pub use splitmix::SplitMix64;
pub use summary::{MIN_VALUES_FOR_P95, MIN_VALUES_FOR_P99, Summary, VALUES_PER_POINT};

/// Possible widths of the buckets of a time axis, seconds, everywhere in PEERNet.
// Each is a multiple of a width that the aggregator stores (1 s, 10 s, 1 min, 1 h): at most 15 times that width, except
// the day, which is 24 hours.
pub const BUCKET_WIDTHS_S: [u32; 15] =
    [1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 900, 3_600, 7_200, 21_600, 86_400];

/// Maximum count that is accepted from other hosts.
// Every integer up to this count is exact as `f64`, and the sum of 2,000 such counts fits into 64 bits.
const MAX_COUNT: u64 = 1 << 53;

/// Largest magnitude of a number that is recorded.
// The squared deviations of `MAX_COUNT` such numbers can be added without overflow.
const MAX_MAGNITUDE: f64 = 1e140;
