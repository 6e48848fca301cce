//! Tests of the agent as a whole: real sockets, real files, several agents in one process.

mod harness;

mod bank;
mod calibration;
mod checking;
mod clocks;
mod conditions;
mod episodes;
mod limits;
mod listening;
mod load;
mod midnight;
mod outage;
mod outbox;
mod partial_answers;
mod remote;
mod replayed;
mod spool;
mod stopping;
mod streaming;
mod superseded;
mod tap;
mod trouble;
