//! Ingest: the path of a frame from the socket to the store. [`socket`] receives frames, and [`session`], [`hosts`] and
//! [`routes`] decide which hosts may send. Admitted work waits in a bounded [`queue`]. A thread turns batches into rows
//! ([`preparing`]), and a task commits them ([`committing`]). [`reopening`] reopens a database whose file failed or was
//! replaced.

mod backoff;
pub(crate) mod committing;
mod connection_log;
mod hosts;
pub(crate) mod preparing;
mod queue;
mod reopening;
mod routes;
mod session;
pub(crate) mod socket;

pub(crate) use self::committing::WriterRequest;
pub(crate) use self::hosts::Hosts;
pub(crate) use self::queue::{CAPACITY_BYTES, MAX_WINDOW, queue};
pub(crate) use self::reopening::Reopening;
pub(crate) use self::session::IngestSession;
