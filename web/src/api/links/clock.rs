//! Schema of the clock relation of a link, of its probes and of its delays.

use peernet_clock::{DelaySource, Offset, Span};
use peernet_stream::{self as stream, DelayPoint, DelaySecond, ProbeCounts};
use serde::Serialize;
use utoipa::ToSchema;

/// Offset between the two related clocks at one time: cloud minus edge. The field `clocks` beside it names the clocks.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct ClockOffset {
    /// Best estimate, seconds. Null, like the bounds, when the verdict is `inconsistent`.
    pub estimate_s: Option<f64>,
    pub lo_s: Option<f64>,
    pub hi_s: Option<f64>,
    /// Source of the bounds: `same-clock`, `in-band`, `kernel`, `chrony`, `intersection` or `none`.
    pub source: &'static str,
    /// Offset by each source alone.
    pub sources: Vec<Source>,
    /// `ok`, `stale` or `inconsistent`.
    pub verdict: &'static str,
    /// Rate at which the offset grows, parts per million; null before there are enough exchanges, and when the verdict
    /// is `inconsistent`.
    pub skew_ppm: Option<f64>,
    /// Number of exchanges since the relation period began.
    pub exchanges: u64,
    /// Seconds since the newest exchange.
    pub age_s: Option<f64>,
}

/// Offset by one source.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Source {
    pub source: &'static str,
    pub lo_s: f64,
    pub hi_s: f64,
}

impl From<&Offset> for ClockOffset {
    fn from(offset: &Offset) -> Self {
        let sources = offset.sources.iter().map(|(source, interval)| Source {
            source: source.name(),
            lo_s: interval.lo.seconds(),
            hi_s: interval.hi.seconds(),
        });
        let consistent = offset.is_consistent();
        let value = |span: Span| consistent.then(|| span.seconds());
        Self {
            estimate_s: value(offset.estimate),
            lo_s: value(offset.bounds.lo),
            hi_s: value(offset.bounds.hi),
            source: if consistent { offset.source } else { DelaySource::None }.name(),
            sources: sources.collect(),
            verdict: offset.verdict.name(),
            skew_ppm: offset.drift_ppm(),
            exchanges: offset.exchanges,
            age_s: offset.age.map(Span::seconds),
        }
    }
}

/// Counts of probes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Probes {
    pub sent: u32,
    pub answered: u32,
    /// Number of probes without an answer in time.
    pub lost: u32,
    /// Number of packets that were rejected as answers, and of probes that could not be sent.
    pub refused: u32,
}

impl From<ProbeCounts> for Probes {
    fn from(ProbeCounts { sent, answered, lost, refused }: ProbeCounts) -> Self {
        Self { sent, answered, lost, refused }
    }
}

/// Round trips of probes, seconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct RoundTrip {
    pub min_s: f64,
    pub median_s: f64,
}

impl From<stream::RoundTrip> for RoundTrip {
    fn from(trip: stream::RoundTrip) -> Self {
        Self { min_s: trip.min.seconds(), median_s: trip.median.seconds() }
    }
}

/// Delays of messages in one direction.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Delay {
    /// Number of delays.
    pub count: u32,
    /// The verdict of the worst 5 % of the delays: at least 5 % of the delays have this verdict or a worse one. For a bucket, each delay counts
    /// with the verdict of its second.
    pub verdict: &'static str,
    /// The median of the delays that have a value, with the medians of their lower and of their upper bounds; null if no delay has a value.
    pub median: Option<MedianDelay>,
}

/// A delay as a point with its error bar.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct MedianDelay {
    pub value_s: f64,
    pub lo_s: f64,
    pub hi_s: f64,
    /// Size of the message with this delay in bits, divided by `value_s`. The delays include messages of all pipelines of the link, so use
    /// `transfers` of a pipeline for its speed. If the verdict is `limited`, only an interval is known: the size divided by `hi_s` and by
    /// `lo_s`. Null if the size is unknown.
    pub bits_per_second: Option<f64>,
}

impl From<DelayPoint> for MedianDelay {
    fn from(point: DelayPoint) -> Self {
        let (lo_s, hi_s) = crate::view::link::delays::non_negative_bounds(&point);
        Self { value_s: point.value.seconds(), lo_s, hi_s, bits_per_second: point.bits_per_second }
    }
}

impl From<&DelaySecond> for Delay {
    fn from(second: &DelaySecond) -> Self {
        let median = second.median.map(MedianDelay::from);
        Self { count: second.count, verdict: second.verdict.name(), median }
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::Verdict;

    use super::*;
    use crate::tests::samples;

    #[test]
    fn inconsistent_offset_has_no_value() {
        let sample = samples::clock_sample(samples::NOW, 1, Some(0.0005));
        let offset = sample.offset.expect("known");
        let consistent = ClockOffset::from(&offset);
        assert_eq!((consistent.estimate_s, consistent.source), (Some(1.204), "intersection"));
        let inconsistent = ClockOffset::from(&Offset { verdict: Verdict::Inconsistent, ..offset });
        assert_eq!(
            (inconsistent.estimate_s, inconsistent.lo_s, inconsistent.hi_s, inconsistent.skew_ppm),
            (None, None, None, None)
        );
        assert_eq!(
            (inconsistent.source, inconsistent.verdict, inconsistent.sources.len()),
            ("none", "inconsistent", 2)
        );
    }
}
