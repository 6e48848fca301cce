//! What is known of the hosts at the other end, above all of their clocks.
//!
//! A [`Link`](pair::Link) stands for one cloud; all pipelines that have a session with it share it, because the
//! relation of two clocks belongs to the pair of hosts. [`Knowledge`](knowledge::Knowledge) is its logic without I/O;
//! `probing` is the task beside it, which probes, listens to what both hosts tell of their clocks and closes each
//! second. A [`NamedReflector`](named_reflector::NamedReflector) of the configuration has a relation of its own.

mod answers;
mod clock_window;
mod connections;
mod correction;
mod judged_stamps;
mod knowledge;
mod named_reflector;
mod network_sessions;
mod pair;
mod probe_pace;
mod probe_target;
mod probing;
mod registry;
mod reports;
mod second;
mod shared;
mod thinned;
mod told_clock;
mod words;

pub(crate) use judged_stamps::{Crossing, EpochWatch, HostStamp};
pub use registry::Cloud;
pub(crate) use registry::{Attached, Links};
pub(crate) use shared::{Near, ProbeSettings};

#[cfg(test)]
pub(crate) use correction::correct;
