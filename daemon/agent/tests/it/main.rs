//! The agent as a whole: real sockets, real files, several agents in one process.

mod harness;

mod calibration;
mod checking;
mod clocks;
mod limits;
mod load;
mod midnight;
mod outage;
mod outbox;
mod remote;
mod spool;
mod stopping;
mod tap;
mod trouble;
