//! Links to clouds: the relation of the clocks of both hosts, and the probes that it needs.
//!
//! A [`Link`](pair::Link) belongs to one cloud. All pipelines with a session to it share the link, over whatever
//! networks, because the relation of two clocks belongs to the pair of hosts. Probes, data exchanges, the peer's
//! announcements and this host's own clock state all end in [`Knowledge`](knowledge::Knowledge), the link's logic
//! without I/O; `probing` is the task that feeds it and closes each second. A
//! [`NamedReflector`](named_reflector::NamedReflector) of the configuration has a separate relation, which is shown
//! live and judges no delay.
//!
//! Once a second a link records a [`ClockSample`](peernet_stream::ClockSample) in the durable lane: the two best
//! exchanges of the second, what was known, and the delays of data. The store feeds them to the same relation to
//! judge a run again. If a pair of hosts uses several networks, there is a sample for each, with the same relation
//! and probes but separate delays.

mod announced_clock;
mod answers;
mod clock_window;
mod connections;
mod correction;
mod downsampled;
mod incident_texts;
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

pub(crate) use judged_stamps::{Crossing, EpochWatch, HostStamp};
pub use registry::Cloud;
pub(crate) use registry::{Attached, Links};
pub(crate) use shared::{LinkContext, ProbeSettings};

#[cfg(test)]
pub(crate) use correction::correct;
