//! Live statistics: one-second summaries of each pipeline, shown to the aggregator every 250 ms.
//!
//! Nothing is queued: an update is put together when it can be handed to the socket, from whatever changed
//! since the last one that was. What could not be sent is part of the next.

mod cell;
mod live_statistics;
mod ring;

pub(crate) use cell::DEADLINE_MISSED;
pub(crate) use live_statistics::{Display, LiveStatistics, Receipt};

use std::time::Duration;

/// How often an update is sent.
pub(crate) const INTERVAL: Duration = Duration::from_millis(250);
