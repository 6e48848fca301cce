//! Sessions over real sockets on loopback.

mod clocks;
mod crowd;
mod failures;
mod handshake;
mod hostile;
mod requests;
mod shutdown;
mod support;
mod wire;
