//! The whole aggregator: real sockets, real SQLite files, agents that speak the real protocol.

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
