//! Statistics of a stream of numbers in bounded memory: moments without cancellation, a mergeable quantile
//! sketch with a stated error, summaries of both, and a ring of one-second cells for the last minutes. [`number`] writes them as people read them.
//! [`SplitMix64`] makes reproducible random numbers.
//!
//! The statistics all merge: what two hosts, seconds or buckets know adds up to what one would have known that was told
//! everything. [`Moments`] and [`Sketch`] are sent and stored, so that what is read of either is checked first.

mod merge;
mod moments;
pub mod number;
mod sketch;
mod splitmix;
mod summary;
mod windows;

pub use merge::Merge;
pub use moments::Moments;
pub use sketch::{PackedError, Sketch};
pub use splitmix::SplitMix64;
pub use summary::Summary;
pub use windows::Windows;

/// Largest count that is taken from elsewhere: every integer up to it is an exact `f64`, and thousands of such
/// counts can be added up in 64 bits.
const MAX_COUNT: u64 = 1 << 53;

/// Largest number of either sign that counts: the squared deviations of [`MAX_COUNT`] such numbers can be added up.
const LARGEST: f64 = 1e140;
