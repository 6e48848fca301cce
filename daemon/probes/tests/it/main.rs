//! Probes over real sockets, and the protocol's logic without them.

mod fixtures;
mod flood;
mod foreign;
mod formats;
mod limits;
mod loopback;
mod random;
mod reflector;
mod sender;
mod support;
