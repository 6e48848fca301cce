//! The way from the socket to the store: the decision who may send ([`session`], [`hosts`], [`routes`]), the socket
//! ([`socket`]), a bounded [`queue`], the thread that turns batches into rows ([`preparing`]), the task that commits
//! them ([`committing`]), and the reopening of a database whose file fails or is replaced ([`reopening`]).

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
