//! Tests of the whole aggregator, with TCP sockets, SQLite files and agents that use the event stream's protocol.

mod agent;
mod bed;
#[expect(unreachable_pub, reason = "shared with the unit tests")]
mod clocks;
#[expect(unreachable_pub, reason = "shared with the unit tests and the benchmark")]
mod generate;
mod hostile;
mod lanes;
mod raw;
mod reopening;
mod room;
mod spool;
mod starting;
mod stopping;
mod trouble;
