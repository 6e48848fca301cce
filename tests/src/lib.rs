//! Harness of the end-to-end tests. The tests start the built programs, as a user or systemd does, in folders of
//! their own.
//!
//! - [`Process`] reads a program's log continuously and ends with the test.
//! - [`Site`] is a folder with ports on the loopback interface.
//! - [`Fleet`] is an aggregator and agents that are killed and restarted, and [`Ledger`] the data that is stored at the end.
//! - [`network`] makes hosts from network namespaces, connected by cables that delay, lose and are captured. [`Plant`] runs
//!   an edge and a cloud in such a network, and [`truth`] compares their reports with the kernel's clock.
//! - [`Stranger`] sends any messages of the event stream's protocol.
//! - [`Desk`] executes the commands of the documents on two machines. A test extracts all commands from the documents and
//!   fails if no test executes one of them.

mod account;
mod api;
mod chance;
mod clock_shim;
mod daemon;
mod desk;
mod disk;
mod documents;
mod false_time;
mod figures;
pub mod fleet;
mod ledger;
pub mod network;
mod plant;
mod process;
mod python;
mod repository;
mod ros;
mod site;
mod spooled;
mod stranger;
mod time;
pub mod truth;

pub use account::Account;
pub use api::Api;
pub use chance::Chance;
pub use clock_shim::{ClockErrors, ClockShim};
pub use daemon::Daemon;
pub use desk::Desk;
pub use disk::{ImageDisk, SecondMount, SmallDisk};
pub use documents::Document;
pub use false_time::FalseTime;
pub use figures::{measured, say, thousands};
pub use fleet::Fleet;
pub use ledger::{Ledger, StoredHost, StoredRun};
pub use network::Network;
pub use peernet_test_ports::free_port;
pub use plant::Plant;
pub use process::{Ended, Process, until, until_grown};
pub use python::python;
pub use repository::{chrony, onnxruntime, program, root};
pub use ros::Ros1System;
pub use site::{AGGREGATOR, Site};
pub use spooled::Spooled;
pub use stranger::{Introduced, Stranger};
pub use time::{Since, wall};

use std::time::Duration;

/// Longest wait for an event that should happen at once, on a machine that is busy with other tests. Such bounds only
/// detect hanging programs; `make bench` measures speed.
pub const PATIENCE: Duration = Duration::from_secs(60);
