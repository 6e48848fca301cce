//! Data of one answer: one snapshot, cut to the limits of an answer.

use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;

use peernet_aggregator::{HostSnapshot, LinkSnapshot, LiveState, PipelineSnapshot};
use peernet_stream::Connection;

use super::aggregator::AggregatorFigures;
use super::table::{Sample, Sink};

/// Hosts of one answer; each makes about twenty lines.
const HOSTS: usize = 4_096;
/// Pipelines of one answer; each makes at most 49 lines.
const PIPELINES: usize = 1_000;
/// Links of one answer; each makes three lines.
const LINKS: usize = 4_096;
/// Connections of one answer; each makes at most 16 lines.
const CONNECTIONS: usize = 1_000;

/// The snapshot.
#[derive(Debug)]
pub(super) struct Scrape {
    pub(super) aggregator: AggregatorFigures,
    pub(super) hosts: Vec<Arc<HostSnapshot>>,
    pub(super) pipelines: Vec<Arc<PipelineSnapshot>>,
    pub(super) links: Vec<Arc<LinkSnapshot>>,
    /// The connections of all links: the link, and the place in its list.
    connections: Vec<(Arc<LinkSnapshot>, usize)>,
    omitted: [(&'static str, usize); 4],
}

impl Scrape {
    /// Copies the required data of a picture. Names are the labels. If several hosts have one name, all but one of them must be
    /// disconnected; the one that reported last is shown.
    pub(super) fn of(picture: &LiveState, aggregator: AggregatorFigures) -> Self {
        let mut by_name: BTreeMap<&str, &Arc<HostSnapshot>> = BTreeMap::new();
        for host in &picture.hosts {
            let held = by_name.entry(host.description.name.as_str()).or_insert(host);
            if (host.connected, host.last_seen) > (held.connected, held.last_seen) {
                *held = host;
            }
        }
        let shown: HashSet<_> = by_name.values().map(|host| host.id).collect();
        let mut hosts: Vec<Arc<HostSnapshot>> = by_name.into_values().cloned().collect();
        let mut pipelines: Vec<Arc<PipelineSnapshot>> =
            picture.pipelines.iter().filter(|one| shown.contains(&one.host)).cloned().collect();
        let mut names = HashSet::new();
        let mut links: Vec<Arc<LinkSnapshot>> = picture
            .links
            .iter()
            .filter(|link| {
                let live = &link.live;
                shown.contains(&link.edge) && names.insert((&link.edge_name, &live.peer_name, live.network()))
            })
            .cloned()
            .collect();
        let listed = |link: &Arc<LinkSnapshot>| {
            let places = 0..link.live.connections.len();
            places.map(|place| (Arc::clone(link), place)).collect::<Vec<_>>()
        };
        // A link that is not reported any more has no open connections.
        let mut connections: Vec<_> = links.iter().filter(|link| link.connected).flat_map(listed).collect();
        let omitted = [
            ("hosts", cut(&mut hosts, HOSTS)),
            ("pipelines", cut(&mut pipelines, PIPELINES)),
            ("links", cut(&mut links, LINKS)),
            ("connections", cut(&mut connections, CONNECTIONS)),
        ];
        Self { aggregator, hosts, pipelines, links, connections, omitted }
    }

    /// Returns the connections, each with its link.
    pub(super) fn connections(&self) -> impl Iterator<Item = (&LinkSnapshot, &Connection)> {
        self.connections
            .iter()
            .filter_map(|(link, place)| Some((&**link, link.live.connections.get(*place)?)))
    }

    /// Writes the number of items beyond the limits, by kind.
    pub(super) fn omitted(&self, to: &mut Sink<'_>) {
        self.omitted.iter().for_each(|(kind, many)| to(&[kind], Sample::Size(*many as u64)));
    }
}

fn cut<T>(items: &mut Vec<T>, most: usize) -> usize {
    let beyond = items.len().saturating_sub(most);
    items.truncate(most);
    beyond
}

#[cfg(test)]
mod tests {
    use peernet_clock::{Span, Verdict};
    use peernet_logger::HostId;

    use super::*;
    use crate::tests::samples;

    #[test]
    fn a_name_stands_once_and_means_the_host_that_reports() {
        let mut old = samples::host("cam-1", "Orin");
        (old.id, old.connected) = (HostId::from_bytes([8; 16]), false);
        old.last_seen = samples::NOW + Span::from_seconds(9);
        let line = samples::pipeline("line", 30.0, 1.0, Verdict::Ok, &[]);
        let mut twin = line.clone();
        twin.host = old.id;
        let mut picture = samples::picture(vec![old, samples::host("cam-1", "Orin")], vec![twin, line]);
        picture.links = vec![Arc::new(samples::link(None, &[])), Arc::new(samples::link(None, &[]))];
        let scrape = Scrape::of(&picture, AggregatorFigures::of(&picture));
        assert_eq!(scrape.hosts.iter().map(|host| host.connected).collect::<Vec<_>>(), [true]);
        assert_eq!((scrape.pipelines.len(), scrape.links.len(), scrape.aggregator.known), (1, 1, 2));
        assert_eq!(scrape.pipelines[0].host, scrape.hosts[0].id);
    }

    #[test]
    fn an_answer_is_bounded_and_says_what_it_leaves_out() {
        let line = |index| samples::pipeline(&format!("line-{index}"), 30.0, 1.0, Verdict::Ok, &[]);
        let picture = samples::picture(vec![samples::host("cam-1", "Orin")], (0..1_200).map(line).collect());
        let aggregator = AggregatorFigures { database_bytes: Some(4_096), ..AggregatorFigures::of(&picture) };
        let text = super::super::render(Scrape::of(&picture, aggregator)).expect("plain text");
        assert_eq!(text.matches("peernet_pipeline_running_bool{").count(), PIPELINES);
        assert!(text.contains("peernet_aggregator_omitted_items{kind=\"pipelines\"} 200\n"), "{text}");
        assert!(text.contains("peernet_aggregator_ready_bool 0\n"));
    }
}
