//! Live statistics: one-second summaries of each pipeline, sent to the aggregator every 250 ms.
//!
//! Updates are not queued. An update is composed when the socket can take it, from the seconds that changed since the
//! last sent update. Seconds that could not be sent are part of the next update.

mod live_statistics;
mod ring;
mod second_statistics;

pub(crate) use live_statistics::{LiveStatistics, PipelineLiveState, Receipt};

use std::time::Duration;

/// Interval between two updates.
pub(crate) const INTERVAL: Duration = Duration::from_millis(250);
