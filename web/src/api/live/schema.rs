//! The events of the live stream.

use peernet_aggregator::{LiveState, Readiness};
use serde::Serialize;
use utoipa::ToSchema;

use crate::api::schema::{Pipeline, PipelineList, time};
use crate::view::clock_fault::FaultyClocks;
use crate::view::storage_notice;

/// `event: picture`: the live figures.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[schema(as = PictureEvent)]
pub(crate) struct LiveStateEvent {
    #[serde(flatten)]
    pub pipelines: PipelineList,
    /// Current state of each host.
    pub hosts: Vec<HostNow>,
}

/// Current state of a host.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct HostNow {
    pub name: String,
    pub connected: bool,
    /// Busy share of all cores, 0 to 1.
    pub cpu: Option<f64>,
    /// Busy share of the accelerators, 0 to 1.
    pub gpu: Option<f64>,
}

impl LiveStateEvent {
    /// Converts a snapshot of the live state, with the last `seconds` seconds of each pipeline.
    pub(crate) fn new(snapshot: &LiveState, seconds: usize) -> Self {
        let hosts = snapshot.hosts.iter().map(|host| HostNow {
            name: host.description.name.to_string(),
            connected: host.connected,
            cpu: host.metrics.cpu,
            gpu: host.metrics.gpu,
        });
        let pipelines = PipelineList::of(snapshot, |pipeline| Pipeline::new(pipeline, seconds));
        Self { pipelines, hosts: hosts.collect() }
    }
}

/// `event: status`: sent to every listener, independent of its topics.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct StatusEvent {
    /// The aggregator's time.
    pub at: String,
    /// Number of hosts that report.
    pub connected: usize,
    /// Number of known hosts.
    pub hosts: usize,
    /// Seconds since the last report of the connected host that has been silent for longest.
    pub behind_s: Option<f64>,
    /// Sentences about clock faults that are injected on purpose, one per host.
    #[serde(rename = "rehearsals")]
    pub clock_faults: Vec<String>,
    /// Reason why events are not being stored, as a sentence; null while they are.
    pub not_storing: Option<String>,
}

impl StatusEvent {
    pub(crate) fn new(snapshot: &LiveState, readiness: &Readiness) -> Self {
        let connected = snapshot.hosts.iter().filter(|host| host.connected);
        let behind = connected.clone().map(|host| (snapshot.at - host.last_seen).seconds().max(0.0));
        Self {
            at: time(snapshot.at),
            connected: connected.count(),
            hosts: snapshot.hosts.len(),
            behind_s: behind.max_by(f64::total_cmp),
            clock_faults: FaultyClocks::of(snapshot).banner(),
            not_storing: storage_notice::notice(readiness),
        }
    }
}
