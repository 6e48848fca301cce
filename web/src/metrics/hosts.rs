//! Metrics of hosts.

use peernet_aggregator::HostSnapshot;
use peernet_clock::Span;

use super::scrape::Scrape;
use super::table::{Sample, Sink};

/// Writes a sample for each host.
pub(super) fn write_each(scrape: &Scrape, sink: &mut Sink<'_>, sample_of: impl Fn(&HostSnapshot) -> Sample) {
    scrape.hosts.iter().for_each(|host| sink(&[host.description.name.as_str()], sample_of(host)));
}

/// Writes a sample for each host for which `sample_of` returns one.
pub(super) fn write_each_known(
    scrape: &Scrape,
    sink: &mut Sink<'_>,
    sample_of: impl Fn(&HostSnapshot) -> Option<Sample>,
) {
    for host in &scrape.hosts {
        if let Some(sample) = sample_of(host) {
            sink(&[host.description.name.as_str()], sample);
        }
    }
}

/// Returns the lag of storage behind measurement, seconds.
pub(super) fn lag(host: &HostSnapshot) -> Sample {
    Sample::Value(host.behind.map_or(0.0, Span::seconds))
}
