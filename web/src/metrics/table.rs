//! The list of all metrics.

use super::scrape::Scrape;
use super::{hosts, links, pipelines};

/// Type of a metric.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Counter,
    Gauge,
}

/// One figure.
#[derive(Clone, Copy, Debug)]
pub(super) enum Sample {
    /// Value of a counter.
    Count(u64),
    /// Integer value of a gauge.
    Size(u64),
    /// Any other value of a gauge.
    Value(f64),
}

impl Sample {
    /// 1 or 0.
    pub(super) fn truth(is: bool) -> Self {
        Self::Size(u64::from(is))
    }
}

/// Receiver of samples: the values of the metric's labels, in their order, and the figure.
pub(super) type Sink<'a> = dyn FnMut(&[&str], Sample) + 'a;

/// One metric; its full name is `peernet_<name>_<unit>`, of a counter with `_total`.
pub(super) struct Metric {
    pub(super) name: &'static str,
    pub(super) unit: &'static str,
    pub(super) kind: Kind,
    pub(super) labels: &'static [&'static str],
    pub(super) help: &'static str,
    pub(super) samples: fn(&Scrape, &mut Sink<'_>),
}

const fn metric(
    (kind, name, unit): (Kind, &'static str, &'static str),
    labels: &'static [&'static str],
    help: &'static str,
    samples: fn(&Scrape, &mut Sink<'_>),
) -> Metric {
    Metric { name, unit, kind, labels, help, samples }
}

const NONE: &[&str] = &[];
const HOST: &[&str] = &["host"];
const PIPELINE: &[&str] = &["host", "pipeline"];
const OUTCOME: &[&str] = &["host", "pipeline", "outcome", "window"];
const WINDOW: &[&str] = &["host", "pipeline", "window"];
const STAGE: &[&str] = &["host", "pipeline", "stage", "quantile"];
const DIRECTION: &[&str] = &["host", "pipeline", "direction"];
const LINK: &[&str] = &["edge", "cloud", "network"];
const CONNECTION: &[&str] = &["edge", "cloud", "network", "pipeline"];
const CONNECTION_DIRECTION: &[&str] = &["edge", "cloud", "network", "pipeline", "direction"];
const INTERFACE: &[&str] = &["edge", "cloud", "network", "pipeline", "interface", "type"];

use Kind::{Counter, Gauge};
use links::End::{Cloud, Edge};

/// All metrics, in the order of the answer.
#[rustfmt::skip]
pub(super) const METRICS: &[Metric] = &[
    metric((Gauge, "aggregator_ready", "bool"), NONE, "1 while batches are stored and acknowledged, else 0.", |s, to| to(&[], Sample::truth(s.aggregator.ready))),
    metric((Gauge, "aggregator_connected", "hosts"), NONE, "Hosts that report.", |s, to| to(&[], Sample::Size(s.aggregator.connected))),
    metric((Gauge, "aggregator_known", "hosts"), NONE, "Hosts of the live picture, those included that are away.", |s, to| to(&[], Sample::Size(s.aggregator.known))),
    metric((Gauge, "aggregator_refused", "hosts"), NONE, "Hosts that were turned away in the last ten minutes, at most 32.", |s, to| to(&[], Sample::Size(s.aggregator.refused))),
    metric((Gauge, "aggregator_omitted", "items"), &["kind"], "Hosts, pipelines, links and connections beyond the limits of this answer.", Scrape::omitted),
    metric((Gauge, "aggregator_database", "bytes"), NONE, "Size of the database's files; absent while there is none.", |s, to| s.aggregator.database(to)),
    metric((Counter, "aggregator_stored", "events"), NONE, "Events that the database holds, of all hosts.", |s, to| to(&[], Sample::Count(s.aggregator.totals.stored.events))),
    metric((Counter, "aggregator_stored", "nodes"), NONE, "Nodes of iterations that were stored, of all hosts.", |s, to| to(&[], Sample::Count(s.aggregator.totals.stored.nodes))),
    metric((Counter, "aggregator_noticed", "gaps"), NONE, "Gaps that hosts reported or that were noticed in their streams.", |s, to| to(&[], Sample::Count(s.aggregator.totals.stored.gaps))),
    metric((Counter, "aggregator_missing", "events"), NONE, "Events missing in those gaps, as far as they could be counted.", |s, to| to(&[], Sample::Count(s.aggregator.totals.stored.missing))),
    metric((Counter, "aggregator_duplicate", "batches"), NONE, "Batches that came again and were stored once, since the aggregator started.", |s, to| to(&[], Sample::Count(s.aggregator.totals.stored.duplicates))),
    metric((Counter, "aggregator_quarantined", "batches"), NONE, "Batches put aside because they could not be stored as they were.", |s, to| to(&[], Sample::Count(s.aggregator.totals.stored.quarantined))),
    metric((Counter, "aggregator_deferred", "batches"), NONE, "Batches for which there was no room and that were asked for again, since the aggregator started.", |s, to| to(&[], Sample::Count(s.aggregator.totals.arrivals.deferred))),
    metric((Counter, "aggregator_damaged", "batches"), NONE, "Batches whose bytes did not match their hash, since the aggregator started.", |s, to| to(&[], Sample::Count(s.aggregator.totals.arrivals.damaged))),
    metric((Counter, "aggregator_unreadable", "frames"), NONE, "Frames that are no message, since the aggregator started.", |s, to| to(&[], Sample::Count(s.aggregator.totals.refused.unreadable))),
    metric((Counter, "aggregator_stranger", "messages"), NONE, "Messages and batches of hosts that did not say hello on that connection, since the aggregator started.", |s, to| to(&[], Sample::Count(s.aggregator.totals.refused.strangers))),
    metric((Counter, "aggregator_rejected", "connections"), &["reason"], "Connections to the agents' port that were turned away or closed for a limit, by reason, since the aggregator started.", |s, to| s.aggregator.rejected(to)),

    metric((Gauge, "host_connected", "bool"), HOST, "1 while the host reports, else 0.", |s, to| hosts::each(s, to, |host| Sample::truth(host.connected))),
    metric((Counter, "host_produced", "events"), HOST, "Events that the agent made since its spool was made; by the agent's account.", |s, to| hosts::each(s, to, |host| Sample::Count(host.accounting.produced))),
    metric((Counter, "host_spooled", "events"), HOST, "Events written to the agent's spool, or stored without it while its disk failed; by the agent's account.", |s, to| hosts::each(s, to, |host| Sample::Count(host.accounting.spooled))),
    metric((Counter, "host_sent", "events"), HOST, "Events sent at least once; by the agent's account.", |s, to| hosts::each(s, to, |host| Sample::Count(host.accounting.sent))),
    metric((Counter, "host_acknowledged", "events"), HOST, "Events acknowledged as stored; by the agent's account.", |s, to| hosts::each(s, to, |host| Sample::Count(host.accounting.stored))),
    metric((Counter, "host_dropped", "events"), HOST, "Events dropped for want of room or lost when the agent was killed, and counted in gaps; by the agent's account.", |s, to| hosts::each(s, to, |host| Sample::Count(host.accounting.dropped))),
    metric((Counter, "host_reported", "gaps"), HOST, "Gaps that the agent reported.", |s, to| hosts::each(s, to, |host| Sample::Count(host.accounting.gaps))),
    metric((Gauge, "host_waiting", "events"), HOST, "Events that wait on the agent, in memory or in its spool.", |s, to| hosts::each(s, to, |host| Sample::Size(host.accounting.waiting))),
    metric((Gauge, "host_lag", "seconds"), HOST, "How far storing is behind measuring: age of the oldest event that waits; 0 when none does.", |s, to| hosts::each(s, to, hosts::lag)),
    metric((Gauge, "host_spool_used", "bytes"), HOST, "Bytes of the batches in the spool.", |s, to| hosts::each(s, to, |host| Sample::Size(host.accounting.spool_bytes))),
    metric((Gauge, "host_spool_limit", "bytes"), HOST, "Bytes that the spool may take.", |s, to| hosts::each(s, to, |host| Sample::Size(host.accounting.spool_limit_bytes))),
    metric((Gauge, "host_unspooled", "bytes"), HOST, "Bytes of events in the agent's memory that are not in its spool yet.", |s, to| hosts::each(s, to, |host| Sample::Size(host.accounting.memory_bytes))),
    metric((Gauge, "host_spool_trouble", "bool"), HOST, "1 while the spool cannot be written or read, else 0.", |s, to| hosts::each(s, to, |host| Sample::truth(host.accounting.trouble.is_some()))),
    metric((Gauge, "host_compressed", "bool"), HOST, "1 while the agent compresses its batches because they wait for the link or the aggregator, else 0.", |s, to| hosts::each(s, to, |host| Sample::truth(host.accounting.compressed))),
    metric((Counter, "host_stored", "events"), HOST, "Events that the database holds of the host; by the aggregator's account.", |s, to| hosts::each(s, to, |host| Sample::Count(host.stored.events))),
    metric((Counter, "host_stored", "nodes"), HOST, "Nodes of iterations that were stored of the host.", |s, to| hosts::each(s, to, |host| Sample::Count(host.stored.nodes))),
    metric((Counter, "host_noticed", "gaps"), HOST, "Gaps of the host that are stored.", |s, to| hosts::each(s, to, |host| Sample::Count(host.stored.gaps))),
    metric((Counter, "host_missing", "events"), HOST, "Events missing in those gaps, as far as they could be counted.", |s, to| hosts::each(s, to, |host| Sample::Count(host.stored.missing))),
    metric((Counter, "host_duplicate", "batches"), HOST, "Batches of the host that came again, since the aggregator started.", |s, to| hosts::each(s, to, |host| Sample::Count(host.stored.duplicates))),
    metric((Counter, "host_quarantined", "batches"), HOST, "Batches of the host that were put aside.", |s, to| hosts::each(s, to, |host| Sample::Count(host.stored.quarantined))),
    metric((Counter, "host_deferred", "batches"), HOST, "Batches of the host for which there was no room, since the aggregator started.", |s, to| hosts::each(s, to, |host| Sample::Count(host.arrivals.deferred))),
    metric((Counter, "host_damaged", "batches"), HOST, "Batches of the host whose bytes did not match their hash, since the aggregator started.", |s, to| hosts::each(s, to, |host| Sample::Count(host.arrivals.damaged))),

    metric((Gauge, "pipeline_running", "bool"), PIPELINE, "1 while the pipeline measures, else 0.", pipelines::running),
    metric((Gauge, "pipeline_window", "iterations"), OUTCOME, "Iterations within the window by outcome (ok, failed, lost, timeout), warm-up left out.", pipelines::iterations),
    metric((Gauge, "pipeline_rate", "hertz"), WINDOW, "Iterations of any outcome per second, over the window.", pipelines::rate),
    metric((Gauge, "pipeline_deadline_missed", "ratio"), WINDOW, "Share of iterations within the window that took longer than their deadline or have no answer, 0 to 1; absent without a deadline.", pipelines::missed),
    metric((Gauge, "pipeline_stage", "seconds"), STAGE, "Quantiles of the standard stages, total and unattributed over 60 s; successful iterations only.", pipelines::stages),
    metric((Gauge, "pipeline_throughput", "bits_per_second"), DIRECTION, "Speed while sending (upload, download) over 60 s: bits over the time that they were on their way; absent while no delay is known.", pipelines::speed),
    metric((Gauge, "pipeline_traffic", "bits_per_second"), DIRECTION, "Traffic (upload, download) of successful iterations: bits per second of wall time over 60 s.", pipelines::traffic),

    metric((Gauge, "link_connected", "bool"), LINK, "1 while the edge reports the link, else 0.", |s, to| links::each(s, to, |link| Some(Sample::truth(link.connected)))),
    metric((Gauge, "link_offset_half_width", "seconds"), LINK, "Half the width of the interval that contains the offset of the two clocks; absent while nothing is known.", |s, to| links::each(s, to, links::half_width)),
    metric((Gauge, "link_probe_loss", "ratio"), LINK, "Share of probes without an answer over 60 s, 0 to 1; absent while none is sent.", |s, to| links::each(s, to, links::loss)),
    metric((Gauge, "link_refused", "probes"), LINK, "Packets that were refused as answers to probes, and probes that could not be sent, over 60 s.", |s, to| links::each(s, to, links::refused)),
    metric((Counter, "link_transferred", "bytes"), CONNECTION_DIRECTION, "Bytes of messages since the connection was opened, without what the transport adds.", |s, to| links::directions(s, to, Edge, |one| Some(one.bytes))),
    metric((Counter, "link_transferred", "messages"), CONNECTION_DIRECTION, "Whole messages since the connection was opened.", |s, to| links::directions(s, to, Edge, |one| Some(one.messages))),
    metric((Counter, "link_transferred", "datagrams"), CONNECTION_DIRECTION, "Datagrams with data, or segments of TCP; absent where the transport does not count them.", |s, to| links::directions(s, to, Edge, |one| one.datagrams)),
    metric((Counter, "link_lost", "datagrams"), CONNECTION_DIRECTION, "Datagrams that did not arrive; absent where the edge cannot know.", |s, to| links::directions(s, to, Edge, |one| one.lost)),
    metric((Counter, "link_duplicated", "datagrams"), CONNECTION_DIRECTION, "Datagrams that arrived more than once; absent where the edge cannot know.", |s, to| links::directions(s, to, Edge, |one| one.duplicated)),
    metric((Counter, "link_reordered", "datagrams"), CONNECTION_DIRECTION, "Datagrams that arrived out of order; absent where the edge cannot know.", |s, to| links::directions(s, to, Edge, |one| one.reordered)),
    metric((Counter, "link_retransmitted", "datagrams"), CONNECTION_DIRECTION, "Datagrams that were sent again; absent where the edge cannot know.", |s, to| links::directions(s, to, Edge, |one| one.retransmitted)),
    metric((Gauge, "link_transport_round_trip", "seconds"), CONNECTION, "Smoothed round trip of the transport's own packets; absent where it measures none.", |s, to| links::transport_round_trips(s, to, Edge)),
    metric((Counter, "link_cloud_transferred", "bytes"), CONNECTION_DIRECTION, "Bytes of messages since the connection was opened, without what the transport adds; by the account of the cloud.", |s, to| links::directions(s, to, Cloud, |one| Some(one.bytes))),
    metric((Counter, "link_cloud_transferred", "messages"), CONNECTION_DIRECTION, "Whole messages since the connection was opened; by the account of the cloud.", |s, to| links::directions(s, to, Cloud, |one| Some(one.messages))),
    metric((Counter, "link_cloud_transferred", "datagrams"), CONNECTION_DIRECTION, "Datagrams with data, or segments of TCP; by the account of the cloud, absent where its transport does not count them.", |s, to| links::directions(s, to, Cloud, |one| one.datagrams)),
    metric((Counter, "link_cloud_lost", "datagrams"), CONNECTION_DIRECTION, "Datagrams that did not arrive; by the account of the cloud, absent where it cannot know.", |s, to| links::directions(s, to, Cloud, |one| one.lost)),
    metric((Counter, "link_cloud_duplicated", "datagrams"), CONNECTION_DIRECTION, "Datagrams that arrived more than once; by the account of the cloud, absent where it cannot know.", |s, to| links::directions(s, to, Cloud, |one| one.duplicated)),
    metric((Counter, "link_cloud_reordered", "datagrams"), CONNECTION_DIRECTION, "Datagrams that arrived out of order; by the account of the cloud, absent where it cannot know.", |s, to| links::directions(s, to, Cloud, |one| one.reordered)),
    metric((Counter, "link_cloud_retransmitted", "datagrams"), CONNECTION_DIRECTION, "Datagrams that were sent again; by the account of the cloud, absent where it cannot know.", |s, to| links::directions(s, to, Cloud, |one| one.retransmitted)),
    metric((Gauge, "link_cloud_transport_round_trip", "seconds"), CONNECTION, "Smoothed round trip of the transport's own packets as the cloud measures it; absent where it measures none.", |s, to| links::transport_round_trips(s, to, Cloud)),
    metric((Gauge, "link_interface_mtu", "bytes"), INTERFACE, "MTU of the edge's interface that the connection leaves by; absent where it is not known.", links::interfaces),
];
