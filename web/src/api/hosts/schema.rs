//! Schema of hosts.

use std::collections::BTreeMap;

use peernet_aggregator::{HostSnapshot, RejectedBatches};
use peernet_clock::Span;
use peernet_store::HostRow;
use peernet_stream::{Accounting, HostDescription, HostMetrics};
use serde::Serialize;
use utoipa::ToSchema;

use crate::api::schema::{HostClock, time};

/// All hosts that report or are stored.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct HostList {
    pub hosts: Vec<Host>,
    /// Injected clock faults by the name of the host, in words. A host that reports to another aggregator is included
    /// if its edges report its fault.
    pub clock_faults: BTreeMap<String, String>,
    /// Hosts whose connections were refused in the last ten minutes, newest first.
    pub refused: Vec<RefusedHost>,
}

/// A host whose connection was refused.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct RefusedHost {
    /// Name that the host sent.
    pub name: String,
    /// Address that the connection came from, if the transport reports it.
    pub address: Option<String>,
    /// Reason of the refusal, and what to do about it.
    pub reason: String,
    /// Time of the host's last attempt, on the aggregator's wall clock.
    pub at: String,
}

impl From<&peernet_aggregator::RefusedHost> for RefusedHost {
    fn from(host: &peernet_aggregator::RefusedHost) -> Self {
        Self {
            name: host.name.to_string(),
            address: host.address.clone(),
            reason: host.reason.clone(),
            at: time(host.at),
        }
    }
}

/// One host.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Host {
    pub id: String,
    pub name: String,
    /// `true` if the host is connected to the aggregator.
    pub connected: bool,
    pub last_seen: String,
    pub description: Description,
    /// Current state; null for a host that is not in the live state.
    pub now: Option<HostNow>,
    /// The host's wall clock as the host reports it; null for a host that is not in the live state.
    pub clock: Option<HostClock>,
    /// Number of the host's events that will never be in the database, as far as they could be counted.
    pub missing_events: u64,
    /// `true` if some of these events could not be counted, so that `missing_events` is the smallest possible number.
    pub missing_events_incomplete: bool,
    pub stored: Stored,
}

/// Hardware and software of a host, as its agent reports them.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Description {
    /// Version of the agent.
    pub version: String,
    /// The kernel's boot id. Hosts with equal `boot_id` and `clock` may read one clock; `same_clock` of a link is true
    /// if that is proven.
    pub boot_id: String,
    /// Name of the clock.
    pub clock: String,
    pub cpu: String,
    pub cores: u32,
    pub memory_bytes: u64,
    pub gpus: Vec<String>,
    pub system: String,
    pub architecture: String,
    /// Addresses at which the host serves models, separated by `, `; null if it serves none.
    pub serves: Option<String>,
    pub models: Vec<String>,
}

/// Current state of a host. Values that the host cannot read are null.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[schema(as = Now)]
pub(crate) struct HostNow {
    /// Wall clock of the host minus that of the aggregator, seconds, by the host's last update. It includes the time
    /// that the update took on the network, so it is only a rough value.
    pub clock_ahead_s: f64,
    /// Lag of storage behind measurement, seconds: age of the oldest event that is not stored, by the host's clock;
    /// null when none waits.
    pub behind_s: Option<f64>,
    /// Progress of storing a backlog; null while the lag does not fall, or is below five seconds.
    pub catching_up: Option<CatchingUp>,
    /// Busy share of all cores, 0 to 1.
    pub cpu: Option<f64>,
    pub memory_used_bytes: Option<u64>,
    /// Busy share of the accelerators, 0 to 1.
    pub gpu: Option<f64>,
    pub temperature_celsius: Option<f64>,
    pub power_watts: Option<f64>,
    /// CPU time of the agent process as a share of one core.
    pub agent_cpu: Option<f64>,
    pub agent_memory_bytes: Option<u64>,
    /// Number of models that the agent has loaded.
    pub loaded_models: Option<u32>,
    /// Sum of the growth of the agent's resident memory while each of these models was loaded; memory of a GPU does not
    /// count.
    pub model_memory_bytes: Option<u64>,
    pub events: EventAccount,
}

/// Counts of an agent's events since its spool was created, as the agent reports them; produced = acknowledged +
/// waiting + dropped.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct EventAccount {
    /// Number of events produced; each reported gap counts as an event.
    pub produced: u64,
    /// Number of produced events that were written to the spool, or stored without the spool while the spool's disk failed.
    pub spooled: u64,
    /// Number of produced events that were sent at least once.
    pub sent: u64,
    /// Number of produced events that were acknowledged as stored.
    pub acknowledged: u64,
    /// Number of events that wait on the agent, in memory or in the spool.
    pub waiting: u64,
    /// Number of events that were dropped because a queue or the spool was full, or lost when the agent was killed. Gaps count these events.
    pub dropped: u64,
    /// Number of gaps reported.
    pub gaps: u64,
    /// Size of the batches in the spool, bytes.
    pub spool_bytes: u64,
    /// Largest size of the spool, bytes.
    pub spool_limit_bytes: u64,
    /// Size of the events in memory that are not in the spool yet, bytes.
    pub memory_bytes: u64,
    /// Time of the oldest waiting event, on the agent's wall clock; null when none waits.
    pub oldest: Option<String>,
    /// `true` if batches are compressed because they wait for the link or the aggregator.
    pub compressed: bool,
    /// Reason why the spool cannot be written or read; null while it works.
    pub trouble: Option<String>,
}

impl From<&Accounting> for EventAccount {
    fn from(account: &Accounting) -> Self {
        let Accounting {
            produced,
            spooled,
            sent,
            stored: acknowledged,
            waiting,
            dropped,
            gaps,
            spool_bytes,
            spool_limit_bytes,
            memory_bytes,
            oldest,
            compressed,
            ref trouble,
        } = *account;
        Self {
            produced,
            spooled,
            sent,
            acknowledged,
            waiting,
            dropped,
            gaps,
            spool_bytes,
            spool_limit_bytes,
            memory_bytes,
            oldest: oldest.map(time),
            compressed,
            trouble: trouble.clone(),
        }
    }
}

/// Progress of storing a backlog.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct CatchingUp {
    /// Seconds by which the lag falls per second, over about the last 10 s.
    pub rate: f64,
    /// Events stored per second, over the same time.
    pub events_per_second: f64,
    /// Seconds until there is no lag, at the present rate.
    pub left_s: f64,
}

/// Counts of a host's data that the aggregator stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Stored {
    /// Events of all kinds.
    pub events: u64,
    /// Nodes of iterations.
    pub nodes: u64,
    /// Gaps that the host reported or that the aggregator detected in its streams.
    pub gaps: u64,
    /// Events missing in the gaps, as far as they could be counted.
    pub missing: u64,
    /// Number of these missing events that were stored in another database before the host connected to this one.
    #[serde(rename = "missing_before")]
    pub in_other_database: u64,
    /// Batches that were received again and not stored again, since the aggregator started.
    pub duplicates: u64,
    /// Batches quarantined because they could not be stored.
    pub quarantined: u64,
    /// Batches that were requested again later because the queue was full, since the aggregator started.
    pub deferred: u64,
    /// Batches whose bytes did not match their hash, since the aggregator started.
    pub damaged: u64,
}

impl Stored {
    fn new(stored: peernet_store::StoredCounts, rejected: RejectedBatches) -> Self {
        let peernet_store::StoredCounts {
            events,
            nodes,
            gaps,
            missing,
            in_other_database,
            unknown_gaps: _,
            unknown_gaps_in_other_database: _,
            duplicates,
            quarantined,
        } = stored;
        let RejectedBatches { deferred, damaged } = rejected;
        Self { events, nodes, gaps, missing, in_other_database, duplicates, quarantined, deferred, damaged }
    }
}

impl From<&HostDescription> for Description {
    fn from(host: &HostDescription) -> Self {
        let hardware = host.hardware.clone();
        Self {
            version: host.version.clone(),
            boot_id: host.clock.boot.to_string(),
            clock: host.clock.clock.to_string(),
            cpu: hardware.cpu,
            cores: hardware.cores,
            memory_bytes: hardware.memory_bytes,
            gpus: hardware.gpus,
            system: hardware.system,
            architecture: hardware.architecture,
            serves: host.serves.clone(),
            models: host.models.iter().map(ToString::to_string).collect(),
        }
    }
}

impl From<&HostSnapshot> for Host {
    fn from(host: &HostSnapshot) -> Self {
        let HostMetrics {
            cpu,
            memory_used_bytes,
            gpu,
            temperature_celsius,
            power_watts,
            agent_cpu,
            agent_memory_bytes,
            models,
        } = host.metrics.clone();
        let missing = host.missing_events();
        Self {
            id: host.id.to_string(),
            name: host.description.name.to_string(),
            connected: host.connected,
            last_seen: time(host.last_seen),
            description: Description::from(&host.description),
            now: Some(HostNow {
                clock_ahead_s: host.clock_ahead.seconds(),
                behind_s: host.behind.map(Span::seconds),
                catching_up: host.catching_up.map(|progress| CatchingUp {
                    rate: progress.rate,
                    events_per_second: progress.events_per_second,
                    left_s: progress.remaining.seconds(),
                }),
                cpu,
                memory_used_bytes,
                gpu,
                temperature_celsius,
                power_watts,
                agent_cpu,
                agent_memory_bytes,
                loaded_models: models.map(|models| models.loaded),
                model_memory_bytes: models.map(|models| models.memory_bytes),
                events: EventAccount::from(&host.accounting),
            }),
            clock: Some(HostClock::from(&host.clock)),
            missing_events: missing.known,
            missing_events_incomplete: missing.is_incomplete,
            stored: Stored::new(host.stored, host.rejected_batches),
        }
    }
}

impl From<&HostRow> for Host {
    fn from(row: &HostRow) -> Self {
        let missing = row.stored.missing_everywhere();
        Self {
            id: row.id.to_string(),
            name: row.name.to_string(),
            connected: false,
            last_seen: time(row.last_seen),
            description: Description::from(&row.description),
            now: None,
            clock: None,
            missing_events: missing.known,
            missing_events_incomplete: missing.is_incomplete,
            stored: Stored::new(row.stored, RejectedBatches::default()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::samples;

    #[test]
    fn missing_events_include_those_that_only_aggregator_found() {
        let missing_events = |dropped: u64, missing: u64, in_other_database: u64| {
            let mut host = samples::host("edge", "robot");
            host.accounting.dropped = dropped;
            (host.stored.missing, host.stored.in_other_database) = (missing, in_other_database);
            Host::from(&host).missing_events
        };
        // Both counts include the gaps that the agent reported, so the counts are not added.
        assert_eq!([missing_events(0, 849, 0), missing_events(1_050, 50, 0)], [849, 1_050]);
        assert_eq!(missing_events(0, 849, 849), 0, "another database has them");
    }

    #[test]
    fn gap_of_unknown_size_makes_missing_events_incomplete() {
        // The events of one of the gaps are stored in another database.
        let is_incomplete = |unknown_gaps: u64| {
            let mut host = samples::host("edge", "robot");
            (host.stored.unknown_gaps, host.stored.unknown_gaps_in_other_database) = (unknown_gaps, 1);
            Host::from(&host).missing_events_incomplete
        };
        assert_eq!([is_incomplete(1), is_incomplete(2)], [false, true]);
    }
}
