//! Tests of probes over real sockets, and of the protocol's state machines without them.

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
