//! Harness of the end-to-end tests. The tests start the built programs, as a user or systemd does, in folders of
//! their own.
//!
//! - [`Process`] reads a program's log continuously and ends with the test.
//! - [`LoopbackDeployment`] is a folder with ports on the loopback interface.
//! - [`Fleet`] is an aggregator and agents that are killed and restarted, and [`StoredEvents`] the data that is stored at
//!   the end.
//! - [`network`] makes hosts from network namespaces, connected by cables that delay, lose and are captured.
//!   [`TwoHostTestbed`] runs an edge and a cloud in such a network, and [`truth`] compares their reports with the
//!   kernel's clock.
//! - [`MisbehavingPeer`] sends any messages of the event stream's protocol.
//! - [`DocumentedCommands`] executes the commands of the documents on two machines. A test extracts all commands from
//!   the documents and fails if no test executes one of them.

mod api;
mod clock_shim;
mod daemon;
mod disk;
mod documented_commands;
mod documents;
mod event_counts;
mod false_time;
mod figures;
pub mod fleet;
mod loopback_deployment;
mod misbehaving_peer;
pub mod network;
mod process;
mod python;
mod repository;
mod ros;
mod spooled_iterations;
mod stored_events;
mod test_rng;
mod time;
pub mod truth;
mod two_host_testbed;

pub use api::Api;
pub use clock_shim::{ClockErrors, ClockShim};
pub use daemon::Daemon;
pub use disk::{ImageDisk, SecondMount, SmallDisk};
pub use documented_commands::DocumentedCommands;
pub use documents::Document;
pub use event_counts::EventCounts;
pub use false_time::FalseTime;
pub use figures::{measured, say, thousands};
pub use fleet::Fleet;
pub use loopback_deployment::{AGGREGATOR, LoopbackDeployment};
pub use misbehaving_peer::{InventedHost, MisbehavingPeer};
pub use network::Network;
pub use peernet_test_ports::free_port;
pub use process::{Process, ProcessEnd, until, until_grown};
pub use python::python;
pub use repository::{chrony, onnxruntime, program, root};
pub use ros::Ros1System;
pub use spooled_iterations::SpooledIterations;
pub use stored_events::{StoredEvents, StoredHost, StoredRun};
pub use test_rng::TestRng;
pub use time::{Stopwatch, wall};
pub use two_host_testbed::TwoHostTestbed;

use std::time::Duration;

/// Longest wait for an event that should happen at once, on a machine that is busy with other tests. Such bounds only
/// detect hanging programs; `make bench` measures speed.
pub const PATIENCE: Duration = Duration::from_secs(60);
