//! The proof that the processes at both ends of a session read one clock, so their offset is exactly zero.
//!
//! Statements of a process about its clock are no proof: clones of a virtual machine have the same boot id, and a
//! preloaded library may show each process other times. Therefore the edge opens an abstract Unix socket while it opens
//! a session, and names this socket in the hello. Such a socket can be reached only within one kernel and one network
//! namespace. A cloud that may read the same clock connects before it accepts the session, and then answers queries.
//!
//! An answer proves three things. Both processes are in one time namespace. The time that each reads through the C
//! library is the time that the kernel returns. The cloud's reading of the free-running clock lies between two readings
//! of the edge. The edge sends a query every two seconds; an answer is valid for five seconds. The delays of hosts
//! without the proof are estimated.
//!
//! ```text
//! messages  query and answer as bytes
//! proof     validity of the answers (no I/O)
//! edge      the socket, and the task that sends queries
//! cloud     connects and answers
//! ```

mod cloud;
mod edge;
mod messages;
mod proof;
#[cfg(test)]
mod tests;

pub(crate) use cloud::ClockResponder;
pub(crate) use edge::{ClockPeers, ClockSocket, prove};
pub(crate) use proof::NotProven;
