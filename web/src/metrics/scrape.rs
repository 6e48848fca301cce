//! Data of one answer: a snapshot of the live state, truncated to the limits of an answer.

use std::collections::HashSet;
use std::sync::Arc;

use peernet_aggregator::{HostSnapshot, LinkSnapshot, LiveState, PipelineSnapshot};
use peernet_stream::Connection;

use super::aggregator::AggregatorNumbers;
use super::table::{Sample, Sink};

/// Maximum number of hosts in one answer; each makes at most 24 lines.
const MAX_HOSTS: usize = 4_096;
/// Maximum number of pipelines in one answer; each makes at most 63 lines.
const MAX_PIPELINES: usize = 1_000;
/// Maximum number of links in one answer; each makes at most four lines.
const MAX_LINKS: usize = 4_096;
/// Maximum number of connections in one answer; each makes at most 31 lines.
const MAX_CONNECTIONS: usize = 1_000;

/// Data of all samples of one answer.
#[derive(Debug)]
pub(super) struct Scrape {
    pub(super) aggregator: AggregatorNumbers,
    pub(super) hosts: Vec<Arc<HostSnapshot>>,
    pub(super) pipelines: Vec<Arc<PipelineSnapshot>>,
    pub(super) links: Vec<Arc<LinkSnapshot>>,
    /// Connections of all links: for each connection its link, and its index in the link's list of connections.
    connections: Vec<(Arc<LinkSnapshot>, usize)>,
    /// Number of items beyond the limits, by kind.
    omitted: [(&'static str, usize); 4],
}

impl Scrape {
    /// Copies the required data of the live state. Samples are labelled with names of hosts, so of several hosts with
    /// the same name only the first is taken, which is the host that the name means.
    pub(super) fn from_live_state(live_state: &LiveState, aggregator: AggregatorNumbers) -> Self {
        let mut hosts = live_state.hosts.clone();
        hosts.dedup_by(|next, host| next.description.name == host.description.name);
        let host_ids: HashSet<_> = hosts.iter().map(|host| host.id).collect();
        let mut pipelines: Vec<Arc<PipelineSnapshot>> = live_state
            .pipelines
            .iter()
            .filter(|pipeline| host_ids.contains(&pipeline.host))
            .cloned()
            .collect();
        // Two samples of one metric must not have the same labels, so of links with the same names only the first is
        // taken.
        let mut names = HashSet::new();
        let mut links: Vec<Arc<LinkSnapshot>> = live_state
            .links
            .iter()
            .filter(|link| {
                let live = &link.live;
                host_ids.contains(&link.edge)
                    && names.insert((&link.edge_name, &live.peer_name, live.network()))
            })
            .cloned()
            .collect();
        let connections_of = |link: &Arc<LinkSnapshot>| {
            let indexes = 0..link.live.connections.len();
            indexes.map(|index| (Arc::clone(link), index)).collect::<Vec<_>>()
        };
        // A link that is not reported any more has no open connections.
        let mut connections: Vec<_> =
            links.iter().filter(|link| link.connected).flat_map(connections_of).collect();
        let omitted = [
            ("hosts", truncate(&mut hosts, MAX_HOSTS)),
            ("pipelines", truncate(&mut pipelines, MAX_PIPELINES)),
            ("links", truncate(&mut links, MAX_LINKS)),
            ("connections", truncate(&mut connections, MAX_CONNECTIONS)),
        ];
        Self { aggregator, hosts, pipelines, links, connections, omitted }
    }

    /// Returns the connections, each with its link.
    pub(super) fn connections(&self) -> impl Iterator<Item = (&LinkSnapshot, &Connection)> {
        self.connections
            .iter()
            .filter_map(|(link, index)| Some((&**link, link.live.connections.get(*index)?)))
    }

    /// Writes the number of items beyond the limits, by kind.
    pub(super) fn write_omitted(&self, sink: &mut Sink<'_>) {
        self.omitted.iter().for_each(|(kind, count)| sink(&[kind], Sample::Size(*count as u64)));
    }
}

/// Truncates a list to `limit` items, and returns the number of omitted items.
fn truncate<T>(items: &mut Vec<T>, limit: usize) -> usize {
    let beyond = items.len().saturating_sub(limit);
    items.truncate(limit);
    beyond
}

#[cfg(test)]
mod tests {
    use peernet_clock::Verdict;
    use peernet_logger::HostId;

    use super::*;
    use crate::tests::samples;

    #[test]
    fn only_first_host_of_a_name_is_taken() {
        let mut old = samples::host("cam-1", "Orin");
        (old.id, old.connected) = (HostId::from_bytes([8; 16]), false);
        let pipeline = samples::pipeline("line", 30.0, 1.0, Verdict::Ok, &[]);
        let mut twin = pipeline.clone();
        twin.host = old.id;
        let mut live_state =
            samples::snapshot(vec![samples::host("cam-1", "Orin"), old], vec![pipeline, twin]);
        live_state.links = vec![Arc::new(samples::link(None, &[])), Arc::new(samples::link(None, &[]))];
        let scrape = Scrape::from_live_state(&live_state, AggregatorNumbers::from_live_state(&live_state));
        assert_eq!(scrape.hosts.iter().map(|host| host.connected).collect::<Vec<_>>(), [true]);
        assert_eq!((scrape.pipelines.len(), scrape.links.len(), scrape.aggregator.known), (1, 1, 2));
        assert_eq!(scrape.pipelines[0].host, scrape.hosts[0].id);
    }

    #[test]
    fn answer_is_bounded_and_counts_omitted_items() {
        let pipeline = |index| samples::pipeline(&format!("line-{index}"), 30.0, 1.0, Verdict::Ok, &[]);
        let live_state =
            samples::snapshot(vec![samples::host("cam-1", "Orin")], (0..1_200).map(pipeline).collect());
        let aggregator = AggregatorNumbers {
            database_bytes: Some(4_096),
            ..AggregatorNumbers::from_live_state(&live_state)
        };
        let text =
            super::super::render(Scrape::from_live_state(&live_state, aggregator)).expect("plain text");
        assert_eq!(text.matches("peernet_pipeline_running_bool{").count(), MAX_PIPELINES);
        assert!(text.contains("peernet_aggregator_omitted_items{kind=\"pipelines\"} 200\n"), "{text}");
        assert!(text.contains("peernet_aggregator_ready_bool 0\n"));
    }
}
