//! The listening side of ZMTP over TCP, with limits per connection, per address and for all connections.
//!
//! The codec is the library's ([`omq_proto`], ZMTP 3.1). Sockets, deadlines and memory are handled here, because the
//! library's own listening socket buffers whatever an unknown peer announces, has no deadline for a hello and no limit
//! per address. A connection is in one of the states below. The layer above is the session logic of a cloud or
//! the ingest of the aggregator. The layer above admits a connection when it accepts a session (cloud) or a host
//! (aggregator) on this connection, and demotes the connection when that session or host ends.
//!
//! | state | until | unfinished input | ended by |
//! | --- | --- | --- | --- |
//! | handshake | greeting and READY have arrived | 8 KiB | 2 s, a newer connection |
//! | unadmitted | the layer above accepts a hello | 64 KiB | the hello timeout, a newer connection |
//! | admitted | its session or host has gone | the listener's budget | silence |
//!
//! While the layer above decides on a hello, the hello timeout does not apply.
//!
//! [`limits`] has the numbers, [`framer`] counts bytes, [`table`] counts connections and decides which connection is
//! closed for a new connection, [`deadlines`] watches times, [`driver`] is the task of a connection.
//!
//! Routing ids that peers choose are refused, because a session belongs to one connection.

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
