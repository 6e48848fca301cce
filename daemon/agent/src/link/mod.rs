//! Links to clouds: the relation of the clocks of both hosts, and the probes that it needs.
//!
//! A [`CloudLink`](cloud_link::CloudLink) belongs to one cloud. All pipelines with a session to that cloud share the
//! link, over any network, because the clock relation belongs to the pair of hosts.
//! [`LinkClockState`](clock_state::LinkClockState) is the link's logic without I/O. Its inputs are probes, data
//! exchanges, the cloud's announcements and the state of this host's clocks. `probing` is the task that passes these
//! inputs to the logic and closes each second. A [`NamedReflector`](named_reflector::NamedReflector) of the
//! configuration has a separate relation, which is only shown live: no delay depends on it.
//!
//! Once a second a link records a [`ClockSample`](peernet_stream::ClockSample) in the durable lane: the two best
//! exchanges of the second, the state of the relation, and the delays of data. The store computes the delays of a run
//! again from these samples. If a pair of hosts uses several networks, there is a sample for each network, with the
//! same relation and probes but separate delays.

mod announced_clock;
mod answer_monitor;
mod clock_state;
mod cloud_link;
mod connections;
mod correction;
mod downsampled;
mod incident_texts;
mod link_second;
mod named_reflector;
mod network_sessions;
mod probe_pace;
mod probe_target;
mod probing;
mod registry;
mod relation_period;
mod reports;
mod shared;
mod transit_stamps;

pub use registry::Cloud;
pub(crate) use registry::{LinkedSession, Links};
pub(crate) use shared::{LinkContext, ProbeSettings};
pub(crate) use transit_stamps::{EpochWatch, HostStamp, TransitStamps};

#[cfg(test)]
pub(crate) use correction::correct;
