//! Stored data survives what operators do to machines.

mod database_file;
