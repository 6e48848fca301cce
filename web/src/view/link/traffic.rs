//! Traffic of a link by pipeline.

use peernet_aggregator::{LiveState, PipelineSnapshot};
use peernet_analysis::transfer::DirectionNodes;
use peernet_clock::Direction;
use peernet_statistics::number::{NONE, bytes, rate};

use super::super::pipeline_table::Cell;
use super::super::place;
use super::super::speed;
use super::{RECENT_SPAN, Subject};

/// One pipeline that uses the link.
// Each pipeline has its own row, because a mean speed over messages of different sizes is meaningless.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct TrafficRow {
    pub name: String,
    pub href: String,
    pub rate: String,
    /// Mean size of a payload, up and down.
    pub sizes: [String; 2],
    /// Speed while sending in MB/s, up and down.
    pub speeds: [Cell; 2],
    pub traffic: Cell,
}

impl TrafficRow {
    /// Returns a row for each pipeline that uses the link.
    pub(crate) fn all(snapshot: &LiveState, subject: &Subject<'_>) -> Vec<Self> {
        let Some(link) = subject.live else { return Vec::new() };
        let uses =
            |one: &&PipelineSnapshot| one.host == link.edge && link.live.pipelines.contains(&one.pipeline);
        snapshot.pipelines.iter().map(|one| &**one).filter(uses).filter_map(Self::new).collect()
    }

    fn new(pipeline: &PipelineSnapshot) -> Option<Self> {
        let window = pipeline.window(RECENT_SPAN.seconds() as u32)?;
        let size =
            |name| window.value(name).map_or_else(|| NONE.to_owned(), |size| bytes(size.mean).to_string());
        let kind = pipeline.placement.kind;
        Some(Self {
            name: pipeline.pipeline.to_string(),
            href: place::pipeline_href(pipeline.host_name.as_str(), pipeline.pipeline.as_str()),
            rate: rate(window.rate_hz),
            sizes: DirectionNodes::both().map(|nodes| size(&nodes.payload)),
            speeds: Direction::ALL.map(|direction| speed::cell(kind, window, direction)),
            traffic: speed::traffic(kind, window),
        })
    }
}
