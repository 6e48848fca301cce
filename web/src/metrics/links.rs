//! Of links.

use peernet_aggregator::LinkPicture;
use peernet_clock::Span;

use super::scrape::Scrape;
use super::table::{Sample, Sink};

/// Over so long probes are counted.
const WINDOW: Span = Span::from_seconds(60);

/// A sample of each link that has one.
pub(super) fn each(scrape: &Scrape, to: &mut Sink<'_>, of: impl Fn(&LinkPicture) -> Option<Sample>) {
    for link in &scrape.links {
        if let Some(sample) = of(link) {
            let live = &link.live;
            to(&[link.edge_name.as_str(), live.peer_name.as_str(), live.network().as_str()], sample);
        }
    }
}

/// Half the width of the offset's interval.
pub(super) fn half_width(link: &LinkPicture) -> Option<Sample> {
    let bounds = link.live.now.offset.as_ref()?.bounds;
    Some(Sample::Value((bounds.hi - bounds.lo).seconds() / 2.0))
}

/// Share of probes that were lost.
pub(super) fn loss(link: &LinkPicture) -> Option<Sample> {
    let newest = link.history.last()?.at;
    let recent = link.history.iter().filter(|point| newest - point.at < WINDOW);
    let (lost, all) = recent.fold((0, 0), |(lost, all), point| {
        let probes = point.probes;
        (lost + u64::from(probes.lost), all + u64::from(probes.lost) + u64::from(probes.answered))
    });
    (all > 0).then(|| Sample::Value(lost as f64 / all as f64))
}
