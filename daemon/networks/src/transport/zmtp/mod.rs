//! The listening side of ZMTP over TCP, with limits on what anybody may cost.
//!
//! The codec is the library's ([`omq_proto`], ZMTP 3.1); sockets and memory are handled here, because the library's
//! own sockets buffer whatever a stranger claims. A connection is in one of these states:
//!
//! | state | until | unfinished input | ended by |
//! | --- | --- | --- | --- |
//! | handshake | greeting and READY have come | 8 KiB | 2 s, a newer connection |
//! | unadmitted | the upper layer accepts a hello | 64 KiB | the hello timeout, a newer connection |
//! | admitted | the session or host behind it is gone | the listener's budget | silence |
//!
//! [`limits`] has the numbers, [`framer`] counts bytes, [`table`] counts connections, [`deadlines`] keeps time,
//! [`driver`] is the task of one.

mod connection;
mod deadlines;
mod driver;
mod framer;
mod limits;
mod listener;
mod rejections;
mod table;

pub use limits::ListenerLimits;
pub use listener::{ZmtpListener, ZmtpSender};
pub use rejections::{Rejection, RejectionCounts};
