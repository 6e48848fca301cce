//! The logger: a tree of typed nodes per iteration, its text, CSV and wire forms, and the messages of the
//! event stream that carries finished trees from agents to the aggregator.
//!
//! No I/O. [`Recorder`] grows a [`Tree`] while an iteration runs; [`stage`] holds the standard names.

pub mod csv;
pub mod fuzzing;
mod guard;
mod host;
pub mod limits;
mod measure;
mod meter;
mod name;
mod recorder;
pub mod stage;
mod stages;
pub mod stream;
mod text;
mod tree;
pub mod wire;

pub use guard::{Measuring, Timing, Tokens};
pub use host::{HostId, InvalidName, RunId, Slug};
pub use measure::{Measure, Rate, Transit};
pub use meter::Meter;
pub use name::{Name, Unit};
pub use recorder::Recorder;
pub use stages::Stages;
pub use text::Text;
pub use tree::{Anchor, Growth, HostIndex, Node, NodeId, Tree, TreeError};
