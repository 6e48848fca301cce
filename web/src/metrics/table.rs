//! The list of all metrics.

use super::scrape::Scrape;
use super::{hosts, links, pipelines};

/// Type of a metric.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Counter,
    Gauge,
}

/// Value of one sample of a metric.
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
    /// Returns the value of a gauge: 1 if the condition is true, else 0.
    pub(super) fn from_bool(condition: bool) -> Self {
        Self::Size(u64::from(condition))
    }
}

/// Callback that receives one sample of a metric at a time: the values of the labels, in the order
/// of [`Metric::labels`], and the value of the sample.
pub(super) type Sink<'a> = dyn FnMut(&[&str], Sample) + 'a;

/// One metric. The full name is `peernet_<name>_<unit>` for a gauge, and `peernet_<name>_<unit>_total` for a counter.
pub(super) struct Metric {
    pub(super) name: &'static str,
    pub(super) unit: &'static str,
    pub(super) kind: Kind,
    /// Names of the labels.
    pub(super) labels: &'static [&'static str],
    pub(super) help: &'static str,
    /// Writes the samples of the metric.
    pub(super) write_samples: fn(&Scrape, &mut Sink<'_>),
}

const fn metric(
    (kind, name, unit): (Kind, &'static str, &'static str),
    labels: &'static [&'static str],
    help: &'static str,
    write_samples: fn(&Scrape, &mut Sink<'_>),
) -> Metric {
    Metric { name, unit, kind, labels, help, write_samples }
}

// Names of the labels, by what a sample of the metric describes.
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
use links::CountingHost::{Cloud, Edge};

/// All metrics, in the order of the answer.
#[rustfmt::skip]
pub(super) const METRICS: &[Metric] = &[
    metric((Gauge, "aggregator_ready", "bool"), NONE, "1 while batches are stored and acknowledged, else 0.", |s, sink| sink(&[], Sample::from_bool(s.aggregator.ready))),
    metric((Gauge, "aggregator_connected", "hosts"), NONE, "Hosts that report.", |s, sink| sink(&[], Sample::Size(s.aggregator.connected))),
    metric((Gauge, "aggregator_known", "hosts"), NONE, "Hosts of the live state, including disconnected ones.", |s, sink| sink(&[], Sample::Size(s.aggregator.known))),
    metric((Gauge, "aggregator_refused", "hosts"), NONE, "Hosts whose connections were refused in the last ten minutes, at most 32.", |s, sink| sink(&[], Sample::Size(s.aggregator.refused))),
    metric((Gauge, "aggregator_omitted", "items"), &["kind"], "Hosts, pipelines, links and connections beyond the limits of this answer.", Scrape::write_omitted),
    metric((Gauge, "aggregator_database", "bytes"), NONE, "Size of the database's files; absent while there are no files.", |s, sink| s.aggregator.write_database(sink)),
    metric((Counter, "aggregator_stored", "events"), NONE, "Events in the database, of all hosts.", |s, sink| sink(&[], Sample::Count(s.aggregator.totals.stored.events))),
    metric((Counter, "aggregator_stored", "nodes"), NONE, "Stored nodes of iterations, of all hosts.", |s, sink| sink(&[], Sample::Count(s.aggregator.totals.stored.nodes))),
    metric((Counter, "aggregator_noticed", "gaps"), NONE, "Gaps that hosts reported or that the aggregator detected in their streams.", |s, sink| sink(&[], Sample::Count(s.aggregator.totals.stored.gaps))),
    metric((Counter, "aggregator_missing", "events"), NONE, "Events missing in the noticed gaps, as far as they could be counted.", |s, sink| sink(&[], Sample::Count(s.aggregator.totals.stored.missing))),
    metric((Counter, "aggregator_duplicate", "batches"), NONE, "Batches that were received again and not stored again, since the aggregator started.", |s, sink| sink(&[], Sample::Count(s.aggregator.totals.stored.duplicates))),
    metric((Counter, "aggregator_quarantined", "batches"), NONE, "Batches quarantined because they could not be stored.", |s, sink| sink(&[], Sample::Count(s.aggregator.totals.stored.quarantined))),
    metric((Counter, "aggregator_deferred", "batches"), NONE, "Batches that were requested again later because the queue was full, since the aggregator started.", |s, sink| sink(&[], Sample::Count(s.aggregator.totals.rejected_batches.deferred))),
    metric((Counter, "aggregator_damaged", "batches"), NONE, "Batches whose bytes did not match their hash, since the aggregator started.", |s, sink| sink(&[], Sample::Count(s.aggregator.totals.rejected_batches.damaged))),
    metric((Counter, "aggregator_unreadable", "frames"), NONE, "Frames that could not be decoded as a message, since the aggregator started.", |s, sink| sink(&[], Sample::Count(s.aggregator.totals.refused.unreadable))),
    metric((Counter, "aggregator_stranger", "messages"), NONE, "Messages and batches of hosts that sent no hello on that connection, since the aggregator started.", |s, sink| sink(&[], Sample::Count(s.aggregator.totals.refused.strangers))),
    metric((Counter, "aggregator_rejected", "connections"), &["reason"], "Connections to the agents' port that were refused or closed because of a limit, by reason, since the aggregator started.", |s, sink| s.aggregator.write_rejections(sink)),

    metric((Gauge, "host_connected", "bool"), HOST, "1 while the host reports, else 0.", |s, sink| hosts::write_each(s, sink, |host| Sample::from_bool(host.connected))),
    metric((Counter, "host_produced", "events"), HOST, "Events that the agent produced since its spool was created, as the agent counts.", |s, sink| hosts::write_each(s, sink, |host| Sample::Count(host.accounting.produced))),
    metric((Counter, "host_spooled", "events"), HOST, "Events written to the agent's spool, or stored without the spool while the agent's disk failed, as the agent counts.", |s, sink| hosts::write_each(s, sink, |host| Sample::Count(host.accounting.spooled))),
    metric((Counter, "host_sent", "events"), HOST, "Events sent at least once, as the agent counts.", |s, sink| hosts::write_each(s, sink, |host| Sample::Count(host.accounting.sent))),
    metric((Counter, "host_acknowledged", "events"), HOST, "Events acknowledged as stored, as the agent counts.", |s, sink| hosts::write_each(s, sink, |host| Sample::Count(host.accounting.stored))),
    metric((Counter, "host_dropped", "events"), HOST, "Events dropped because a queue or the spool was full, or lost when the agent was killed, as the agent counts; gaps include these events.", |s, sink| hosts::write_each(s, sink, |host| Sample::Count(host.accounting.dropped))),
    metric((Counter, "host_reported", "gaps"), HOST, "Gaps that the agent reported.", |s, sink| hosts::write_each(s, sink, |host| Sample::Count(host.accounting.gaps))),
    metric((Gauge, "host_waiting", "events"), HOST, "Events that wait on the agent, in memory or in its spool.", |s, sink| hosts::write_each(s, sink, |host| Sample::Size(host.accounting.waiting))),
    metric((Gauge, "host_lag", "seconds"), HOST, "Lag of storage behind measurement: age of the oldest waiting event; 0 when no event waits.", |s, sink| hosts::write_each(s, sink, hosts::lag)),
    metric((Gauge, "host_spool_used", "bytes"), HOST, "Bytes of the batches in the spool.", |s, sink| hosts::write_each(s, sink, |host| Sample::Size(host.accounting.spool_bytes))),
    metric((Gauge, "host_spool_limit", "bytes"), HOST, "Maximum number of bytes of the spool.", |s, sink| hosts::write_each(s, sink, |host| Sample::Size(host.accounting.spool_limit_bytes))),
    metric((Gauge, "host_unspooled", "bytes"), HOST, "Bytes of events in the agent's memory that are not in its spool yet.", |s, sink| hosts::write_each(s, sink, |host| Sample::Size(host.accounting.memory_bytes))),
    metric((Gauge, "host_spool_trouble", "bool"), HOST, "1 while the spool cannot be written or read, else 0.", |s, sink| hosts::write_each(s, sink, |host| Sample::from_bool(host.accounting.trouble.is_some()))),
    metric((Gauge, "host_compressed", "bool"), HOST, "1 while the agent compresses its batches because they wait for the link or the aggregator, else 0.", |s, sink| hosts::write_each(s, sink, |host| Sample::from_bool(host.accounting.compressed))),
    metric((Gauge, "host_loaded", "models"), HOST, "Models that the agent has loaded.", |s, sink| hosts::write_each_known(s, sink, |host| host.metrics.models.map(|models| Sample::Size(models.loaded.into())))),
    metric((Gauge, "host_model_memory", "bytes"), HOST, "Sum over the loaded models: growth of the agent's resident memory while the model was loaded; without the memory of a GPU.", |s, sink| hosts::write_each_known(s, sink, |host| host.metrics.models.map(|models| Sample::Size(models.memory_bytes)))),
    metric((Counter, "host_stored", "events"), HOST, "Events of the host in the database, counted by the aggregator.", |s, sink| hosts::write_each(s, sink, |host| Sample::Count(host.stored.events))),
    metric((Counter, "host_stored", "nodes"), HOST, "Stored nodes of the host's iterations.", |s, sink| hosts::write_each(s, sink, |host| Sample::Count(host.stored.nodes))),
    metric((Counter, "host_noticed", "gaps"), HOST, "Gaps in the host's events that the database records.", |s, sink| hosts::write_each(s, sink, |host| Sample::Count(host.stored.gaps))),
    metric((Counter, "host_missing", "events"), HOST, "Events missing in the noticed gaps, as far as they could be counted.", |s, sink| hosts::write_each(s, sink, |host| Sample::Count(host.stored.missing))),
    metric((Counter, "host_duplicate", "batches"), HOST, "Batches of the host that were received again, since the aggregator started.", |s, sink| hosts::write_each(s, sink, |host| Sample::Count(host.stored.duplicates))),
    metric((Counter, "host_quarantined", "batches"), HOST, "Batches of the host that were quarantined.", |s, sink| hosts::write_each(s, sink, |host| Sample::Count(host.stored.quarantined))),
    metric((Counter, "host_deferred", "batches"), HOST, "Batches of the host that were requested again later because the queue was full, since the aggregator started.", |s, sink| hosts::write_each(s, sink, |host| Sample::Count(host.rejected_batches.deferred))),
    metric((Counter, "host_damaged", "batches"), HOST, "Batches of the host whose bytes did not match their hash, since the aggregator started.", |s, sink| hosts::write_each(s, sink, |host| Sample::Count(host.rejected_batches.damaged))),

    metric((Gauge, "pipeline_running", "bool"), PIPELINE, "1 while the pipeline measures, else 0.", pipelines::write_running),
    metric((Gauge, "pipeline_window", "iterations"), OUTCOME, "Iterations within the window by outcome (ok, failed, lost, timeout), without warm-up.", pipelines::write_iterations),
    metric((Gauge, "pipeline_rate", "hertz"), WINDOW, "Iterations of any outcome per second, over the window.", pipelines::write_rate),
    metric((Gauge, "pipeline_deadline_missed", "ratio"), WINDOW, "Share of iterations within the window that took longer than their deadline or failed, 0 to 1; absent without a deadline.", pipelines::write_missed),
    metric((Gauge, "pipeline_superseded", "answers"), WINDOW, "Answers within the window that were not acted on, because the answer to a newer sample had been acted on or the episode had ended; absent if there are no such answers.", pipelines::write_superseded),
    metric((Gauge, "pipeline_episode_success", "ratio"), WINDOW, "Share of the episodes that ended within the window that were a success, 0 to 1; absent if no episode ended or no success is reported.", pipelines::write_episode_success),
    metric((Gauge, "pipeline_stage", "seconds"), STAGE, "Quantiles of the standard stages, total and unattributed, of the last 60 s; successful iterations only.", pipelines::write_stages),
    metric((Gauge, "pipeline_throughput", "bits_per_second"), DIRECTION, "Speed while sending (upload, download) in the last 60 s: bits divided by their transfer time; absent if no delay is known or the clocks do not determine the delays.", pipelines::write_speed),
    metric((Gauge, "pipeline_traffic", "bits_per_second"), DIRECTION, "Traffic (upload, download) of successful iterations: bits per second of wall time, in the last 60 s.", pipelines::write_traffic),

    metric((Gauge, "link_connected", "bool"), LINK, "1 while the edge reports the link, else 0.", |s, sink| links::write_each(s, sink, |link| Some(Sample::from_bool(link.connected)))),
    metric((Gauge, "link_offset_half_width", "seconds"), LINK, "Half the width of the interval that contains the offset of the two clocks; absent while the offset is not known.", |s, sink| links::write_each(s, sink, links::half_width)),
    metric((Gauge, "link_probe_loss", "ratio"), LINK, "Share of the probes of the last 60 s that got no answer, 0 to 1; absent while no probe is sent.", |s, sink| links::write_each(s, sink, links::loss)),
    metric((Gauge, "link_refused", "probes"), LINK, "Packets that were refused as answers to probes, and probes that could not be sent, in the last 60 s.", |s, sink| links::write_each(s, sink, links::refused)),
    metric((Counter, "link_transferred", "bytes"), CONNECTION_DIRECTION, "Bytes of messages since the connection was opened, without the overhead of the transport.", |s, sink| links::write_directions(s, sink, Edge, |direction| Some(direction.bytes))),
    metric((Counter, "link_transferred", "messages"), CONNECTION_DIRECTION, "Whole messages since the connection was opened.", |s, sink| links::write_directions(s, sink, Edge, |direction| Some(direction.messages))),
    metric((Counter, "link_transferred", "datagrams"), CONNECTION_DIRECTION, "Datagrams with data, or segments of TCP; absent where the transport does not count them.", |s, sink| links::write_directions(s, sink, Edge, |direction| direction.datagrams)),
    metric((Counter, "link_lost", "datagrams"), CONNECTION_DIRECTION, "Datagrams that did not arrive; absent where the edge cannot know.", |s, sink| links::write_directions(s, sink, Edge, |direction| direction.lost)),
    metric((Counter, "link_duplicated", "datagrams"), CONNECTION_DIRECTION, "Datagrams that arrived more than once; absent where the edge cannot know.", |s, sink| links::write_directions(s, sink, Edge, |direction| direction.duplicated)),
    metric((Counter, "link_reordered", "datagrams"), CONNECTION_DIRECTION, "Datagrams that arrived out of order; absent where the edge cannot know.", |s, sink| links::write_directions(s, sink, Edge, |direction| direction.reordered)),
    metric((Counter, "link_retransmitted", "datagrams"), CONNECTION_DIRECTION, "Datagrams that were sent again; absent where the edge cannot know.", |s, sink| links::write_directions(s, sink, Edge, |direction| direction.retransmitted)),
    metric((Gauge, "link_transport_round_trip", "seconds"), CONNECTION, "Smoothed round trip of the transport's own packets; absent where the transport measures none.", |s, sink| links::write_transport_round_trips(s, sink, Edge)),
    metric((Counter, "link_cloud_transferred", "bytes"), CONNECTION_DIRECTION, "Bytes of messages since the connection was opened, without the overhead of the transport, counted by the cloud.", |s, sink| links::write_directions(s, sink, Cloud, |direction| Some(direction.bytes))),
    metric((Counter, "link_cloud_transferred", "messages"), CONNECTION_DIRECTION, "Whole messages since the connection was opened, counted by the cloud.", |s, sink| links::write_directions(s, sink, Cloud, |direction| Some(direction.messages))),
    metric((Counter, "link_cloud_transferred", "datagrams"), CONNECTION_DIRECTION, "Datagrams with data, or segments of TCP, counted by the cloud; absent where its transport does not count them.", |s, sink| links::write_directions(s, sink, Cloud, |direction| direction.datagrams)),
    metric((Counter, "link_cloud_lost", "datagrams"), CONNECTION_DIRECTION, "Datagrams that did not arrive, counted by the cloud; absent where the cloud cannot know.", |s, sink| links::write_directions(s, sink, Cloud, |direction| direction.lost)),
    metric((Counter, "link_cloud_duplicated", "datagrams"), CONNECTION_DIRECTION, "Datagrams that arrived more than once, counted by the cloud; absent where the cloud cannot know.", |s, sink| links::write_directions(s, sink, Cloud, |direction| direction.duplicated)),
    metric((Counter, "link_cloud_reordered", "datagrams"), CONNECTION_DIRECTION, "Datagrams that arrived out of order, counted by the cloud; absent where the cloud cannot know.", |s, sink| links::write_directions(s, sink, Cloud, |direction| direction.reordered)),
    metric((Counter, "link_cloud_retransmitted", "datagrams"), CONNECTION_DIRECTION, "Datagrams that were sent again, counted by the cloud; absent where the cloud cannot know.", |s, sink| links::write_directions(s, sink, Cloud, |direction| direction.retransmitted)),
    metric((Gauge, "link_cloud_transport_round_trip", "seconds"), CONNECTION, "Smoothed round trip of the transport's own packets as the cloud measures it; absent where the cloud measures none.", |s, sink| links::write_transport_round_trips(s, sink, Cloud)),
    metric((Gauge, "link_interface_mtu", "bytes"), INTERFACE, "MTU of the edge's interface that the connection uses; absent where it is unknown.", links::write_interfaces),
];
