//! The logger: a tree of typed nodes per iteration, its text, CSV and wire forms, and the messages of the
//! event stream that carries finished trees from agents to the aggregator.
//!
//! No I/O. [`Recorder`] grows a [`Tree`] while an iteration runs; [`stage`] holds the standard names.

mod host;
mod name;
mod recorder;
pub mod stage;
pub mod stream;
mod tree;

pub use host::{HostId, Slug, InvalidName, RunId};
pub use name::{Name, Unit};
pub use recorder::{Recorder, Timing};
pub use tree::{Anchor, Growth, HostIndex, Measure, Node, NodeId, Rate, Transit, Tree, TreeError};
