//! Live statistics: one-second summaries of each pipeline, sent to the aggregator every 250 ms.
//!
//! Nothing is queued: an update is composed when it can be handed to the socket, from the seconds that changed since
//! the last one that was sent. Seconds that could not be sent are part of the next update.

mod cell;
mod live_statistics;
mod ring;

pub(crate) use cell::DEADLINE_MISSED;
pub(crate) use live_statistics::{Display, LiveStatistics, Receipt};

use std::time::Duration;

/// Interval between two updates.
pub(crate) const INTERVAL: Duration = Duration::from_millis(250);
