//! Harness of the end-to-end tests. Tests start the built programs as a user or systemd does, each test in its own
//! folder.
//!
//! - [`Process`] starts a program, reads its log continuously, and kills it when the test ends.
//! - [`LoopbackDeployment`] is a folder with ports on the loopback interface.
//! - [`Fleet`] is an aggregator with agents that can be killed and restarted. [`StoredEvents`] counts what the aggregator
//!   stored.
//! - [`network`] creates hosts in network namespaces, with links between them that can delay, drop and capture packets.
//!   [`TwoHostTestbed`] runs an edge and a cloud in such a network, and [`truth`] compares their reports with the
//!   kernel's clock.
//! - [`MisbehavingPeer`] sends arbitrary messages of the event stream's protocol.
//! - [`DocumentedCommands`] executes the commands of the documents on two machines. Another test extracts all commands
//!   from the documents and fails if a command is executed by no test.

mod api;
mod clock_shim;
mod daemon;
mod disk;
mod documented_commands;
mod documents;
mod event_counts;
mod false_time;
pub mod fleet;
mod loopback_deployment;
mod measurements;
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
pub use fleet::Fleet;
pub use loopback_deployment::{AGGREGATOR, LoopbackDeployment};
pub use measurements::{print_line, record_measurements, thousands};
pub use misbehaving_peer::{InventedHost, MisbehavingPeer};
pub use network::Network;
pub use peernet_test_ports::free_port;
pub use process::{Process, ProcessEnd, wait_until, wait_until_grown};
pub use python::python;
pub use repository::{chrony, onnxruntime, program, root};
pub use ros::Ros1System;
pub use spooled_iterations::SpooledIterations;
pub use stored_events::{StoredEvents, StoredHost, StoredRun};
pub use test_rng::TestRng;
pub use time::{Stopwatch, wall};
pub use two_host_testbed::TwoHostTestbed;

use std::time::Duration;

/// Timeout of waits for something that should happen at once.
///
/// It only detects programs that hang, and is long because other tests load the machine. `make bench` measures speed.
pub const TEST_TIMEOUT: Duration = Duration::from_secs(60);
