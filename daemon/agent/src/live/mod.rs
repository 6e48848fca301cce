//! Live statistics: one-second summaries of each pipeline, shown to the aggregator every 250 ms.
//!
//! Nothing is queued: an update is put together when it can be handed to the socket, from whatever changed
//! since the last one that was. What could not be sent is part of the next.

mod board;
mod cell;
mod ring;

pub(crate) use board::{Board, Display, Receipt};
pub(crate) use cell::DEADLINE_MISSED;

use std::time::Duration;

/// How often an update is sent.
pub(crate) const INTERVAL: Duration = Duration::from_millis(250);
