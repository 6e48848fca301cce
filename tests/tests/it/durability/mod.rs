//! Stored data survives what operators do to machines.

mod database_file;
mod lost_events;
mod memory;

use super::stream::{setting, turn};
