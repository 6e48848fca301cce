//! Tests of sessions over real sockets on loopback.

mod acceptance;
mod clocks;
mod crowd;
mod failures;
mod fake_cloud;
mod handshake;
mod hostile;
mod invalid_answer_log;
mod limits;
mod partial_replies;
mod requests;
mod ros;
mod ros_limits;
mod ros_master;
mod shutdown;
mod statistics;
mod support;
mod udp;
mod udp_relay;
mod versions;
mod wire;
