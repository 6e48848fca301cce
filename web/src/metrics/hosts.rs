//! Metrics of hosts.

use peernet_aggregator::HostSnapshot;
use peernet_clock::Span;

use super::scrape::Scrape;
use super::table::{Sample, Sink};

/// Writes a sample of each host.
pub(super) fn each(scrape: &Scrape, to: &mut Sink<'_>, of: impl Fn(&HostSnapshot) -> Sample) {
    scrape.hosts.iter().for_each(|host| to(&[host.description.name.as_str()], of(host)));
}

/// Returns the delay of storing behind measuring, seconds.
pub(super) fn lag(host: &HostSnapshot) -> Sample {
    Sample::Value(host.behind.map_or(0.0, Span::seconds))
}
