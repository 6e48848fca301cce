//! Results as a whole: rows in, files out, rows back.

mod files;
mod published;
mod summary;

use peernet_clock::WallTime;
use peernet_logger::{Measure, RunId, Unit};
use peernet_stream::Outcome as Ended;

use super::*;
use crate::testing::{BEGUN, add, iteration, kept, offloaded, rows, timer};
