//! Tests that stored data survives faults of disks, clocks and processes.

mod clock_jump;
mod damaged_page;
mod database_file;
mod lost_events;
mod memory;
mod storm;

use super::stream::{setting, wait_for_turn};
