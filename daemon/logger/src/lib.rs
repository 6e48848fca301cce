//! The logger: one tree of typed nodes per iteration, and its text, CSV and wire forms.
//!
//! The crate does no I/O. Modules, from the lowest layer up:
//!
//! - [`Name`], [`Unit`], [`Measure`]: the name of a node, its unit, and what it measured; [`stage`]: the standard
//!   names.
//! - [`Tree`]: the nodes of one iteration on all hosts that took part; [`limits`]: the maximum size of a tree.
//! - [`Recorder`]: builds a tree while an iteration runs. Its guards close the nodes that they opened. Programs can add
//!   custom instruments ([`Meter`]).
//! - [`fact`]: names of facts about a run.
//! - [`wire`], `text`, [`csv`]: the binary form, the text for people, and the row of a table.

pub mod csv;
pub mod fact;
mod host;
mod iteration_values;
pub mod limits;
mod measure;
mod meter;
mod name;
mod recorder;
mod text;
mod tree;
mod tree_error;
pub mod wire;

pub use host::{HostId, InvalidName, RunId, Slug};
pub use iteration_values::{CountedNodes, IterationValues, NodeRole};
pub use measure::{Measure, Rate, RawStamps, Transit};
pub use meter::Meter;
pub use name::{Name, Unit, stage};
pub use recorder::{MeterGuard, Recorder, TimerGuard, TokenGuard};
pub use text::Text;
pub use tree::{Anchor, HostIndex, Node, NodeId, Tree, TreeDelta};
pub use tree_error::TreeError;
