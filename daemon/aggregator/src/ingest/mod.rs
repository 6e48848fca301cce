//! From the socket to the store: who may speak ([`session`], [`hosts`], [`routes`]), the socket itself ([`socket`]), a bounded [`queue`], the
//! thread that makes rows of what was let in ([`preparing`]), and the task that commits them ([`committing`]), which opens
//! the database anew when its file fails or is replaced ([`reopening`]).

pub(crate) mod committing;
mod connection_log;
mod hosts;
pub(crate) mod preparing;
mod queue;
mod reopening;
mod routes;
mod session;
pub(crate) mod socket;

pub(crate) use self::committing::Errand;
pub(crate) use self::hosts::Hosts;
pub(crate) use self::queue::{MOST_WINDOW, ROOM_BYTES, queue};
pub(crate) use self::reopening::Reopening;
pub(crate) use self::session::IngestSession;
