//! Stored data survives what operators do to machines.

mod database_file;
mod memory;

use super::stream::setting;
