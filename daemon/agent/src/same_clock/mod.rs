//! The proof that the processes at both ends of a session read one clock, so that their offset is exactly zero.
//!
//! Nothing that a process says of its clock proves that: clones of a virtual machine tell one boot id, and a preloaded library shows
//! one process other times than the next. So the edge opens an abstract Unix socket while it opens a session and names it there. Such a
//! socket is reached within one kernel and one network namespace only. A cloud that may be on the same clock connects before it accepts
//! the session, and then answers questions: both processes are in one time namespace, each reads through the C library what the kernel
//! shows by a direct call, and what the cloud reads of the free-running clock lies between two reads of the edge. The edge asks every
//! two seconds and believes an answer for five. Whoever does not prove it is measured like any other pair.
//!
//! ```text
//! messages  question and answer as bytes
//! proof     what an answer proves, and for how long. No I/O
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
