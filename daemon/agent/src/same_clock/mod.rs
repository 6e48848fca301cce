//! The proof that the processes at both ends of a session read one clock, so that their offset is exactly zero.
//!
//! Nothing that a process says about its clock proves that: clones of a virtual machine have the same boot id, and a
//! preloaded library may show one process other times than the next. So the edge opens an abstract Unix socket while
//! it opens a session, and names it in the hello. Such a socket can be reached only within one kernel and one network
//! namespace. A cloud that may be on the same clock connects before it accepts the session, and then answers
//! questions. An answer proves three things: both processes are in one time namespace; each reads through the C
//! library the time that a direct system call returns; and the cloud's reading of the free-running clock lies between
//! two readings of the edge. The edge asks every two seconds and relies on an answer for five. Pairs without the
//! proof are measured like any others.
//!
//! ```text
//! messages  question and answer as bytes
//! proof     what an answer proves, and for how long (no I/O)
//! edge      the socket, and the task that asks
//! cloud     connects and answers
//! ```

mod cloud;
mod edge;
mod messages;
mod proof;
#[cfg(test)]
mod tests;

pub(crate) use cloud::ClockWitness;
pub(crate) use edge::{ClockPeers, ClockSocket, prove};
pub(crate) use proof::NotProven;
