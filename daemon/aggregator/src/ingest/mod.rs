//! From the socket to the store: who may speak ([`desk`]), the socket itself ([`socket`]), and the task that
//! commits what was let in ([`committing`]), with a bounded [`queue`] between them.

pub(crate) mod committing;
mod desk;
mod queue;
mod refusals;
pub(crate) mod socket;

pub(crate) use self::desk::Desk;
pub(crate) use self::queue::queue;
