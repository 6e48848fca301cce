//! The logger: a tree of typed nodes per iteration, and its text, CSV and wire forms.
//!
//! No I/O. From the ground up:
//!
//! - [`Name`], [`Unit`], [`Measure`]: what a node is called and what it measured; [`stage`]: the standard names.
//! - [`Tree`]: the nodes of one iteration, across hosts; [`limits`]: how large it may become.
//! - [`Recorder`]: grows a tree while an iteration runs, through guards that close what they opened, also with
//!   instruments of a user's own ([`Meter`]).
//! - [`Stages`]: what the stages of a finished tree add up to.
//! - [`wire`], `text`, [`csv`]: a tree for machines, for people, and as a row of a table.

pub mod csv;
mod host;
pub mod limits;
mod measure;
mod meter;
mod name;
mod recorder;
mod stages;
mod text;
mod tree;
mod tree_error;
pub mod wire;

pub use host::{HostId, InvalidName, RunId, Slug};
pub use measure::{Measure, Rate, RawStamps, Transit};
pub use meter::Meter;
pub use name::{Name, Unit, stage};
pub use recorder::{Measuring, Recorder, Timing, Tokens};
pub use stages::Stages;
pub use text::Text;
pub use tree::{Anchor, Growth, HostIndex, Node, NodeId, Tree};
pub use tree_error::TreeError;
