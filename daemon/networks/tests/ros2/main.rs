//! Tests of sessions over topics of ROS 2, and the tests of `it` for every network including ROS 2.
//!
//! This is a separate test program, so that a build of the workspace with `--test ros2` produces the tests of ROS 2 and
//! no other tests.

#[path = "../it/acceptance.rs"]
mod acceptance;
#[path = "../it/clocks.rs"]
mod clocks;
#[path = "../it/crowd.rs"]
mod crowd;
#[path = "../it/failures.rs"]
mod failures;
#[path = "../it/fake_cloud.rs"]
mod fake_cloud;
#[path = "../it/handshake.rs"]
mod handshake;
#[path = "../it/hostile.rs"]
mod hostile;
#[path = "../it/limits.rs"]
mod limits;
#[path = "../it/partial_replies.rs"]
mod partial_replies;
#[path = "../it/requests.rs"]
mod requests;
#[path = "../it/ros.rs"]
mod ros;
#[path = "../it/ros_limits.rs"]
mod ros_limits;
#[path = "../it/ros_master.rs"]
mod ros_master;
mod sessions;
#[path = "../it/shutdown.rs"]
mod shutdown;
#[path = "../it/statistics.rs"]
mod statistics;
#[path = "../it/support.rs"]
mod support;
#[path = "../it/udp.rs"]
mod udp;
#[path = "../it/udp_relay.rs"]
mod udp_relay;
#[path = "../it/versions.rs"]
mod versions;
#[path = "../it/wire.rs"]
mod wire;
