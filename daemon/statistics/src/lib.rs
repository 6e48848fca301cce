//! Statistics of a stream of numbers in bounded memory: moments without cancellation, a mergeable quantile
//! sketch with a stated error, and summaries of both.

mod moments;
mod sketch;
mod summary;

pub use moments::Moments;
pub use sketch::Sketch;
pub use summary::Summary;
