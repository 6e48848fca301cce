//! The harness of the end-to-end tests: real processes of the real programs, in folders of their own.

mod api;
pub mod network;
mod plant;
mod process;
mod repository;
mod site;
pub mod truth;

pub use api::Api;
pub use network::Network;
pub use plant::Plant;
pub use process::{Ended, Process, until};
pub use repository::{chrony, onnxruntime, program, root};
pub use site::{AGGREGATOR, Site, free_port};

use std::time::Duration;

/// How long a test waits for something that should happen at once, on a machine that is busy with other tests.
pub const PATIENCE: Duration = Duration::from_secs(60);
