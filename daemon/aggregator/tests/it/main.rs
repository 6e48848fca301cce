//! Tests of the whole aggregator, with TCP sockets, SQLite files and agents that use the event stream's protocol.

mod agent;
#[expect(unreachable_pub, reason = "shared with the unit tests")]
mod clocks;
mod faulty_agents;
mod full_queue;
#[expect(unreachable_pub, reason = "shared with the unit tests and the benchmark")]
mod generate;
mod hostile;
mod lanes;
mod reopening;
mod scripted_agent;
mod spool;
mod starting;
mod stopping;
mod testbed;
