//! Clock samples and links as agents send them.

use peernet_clock::{DelaySource, Exchange, ExchangeCounts, Interval, Offset, RawTime, Span, Verdict};
use peernet_logger::HostId;
use peernet_stream::{
    ClockSample, DelayPoint, DelaySecond, HostClock, LinkLive, NetworkName, ProbeCounts, Probing, RoundTrip,
};

use super::generate;

/// Returns an interval from `lo` to `hi` microseconds.
pub fn micros(lo: i64, hi: i64) -> Interval {
    Interval { lo: Span::from_micros(lo), hi: Span::from_micros(hi) }
}

/// Returns the sample of the second that ends `second` seconds after the zero of [`generate::at`], with all optional
/// fields. The cloud's clock is 250 ms ahead, with bounds of ± `width` µs.
pub fn sample(peer: HostId, second: i64, width: i64) -> ClockSample {
    let at = generate::at(second as f64);
    let sent = RawTime::from_wall(at - Span::from_millis(400));
    let clock_ahead = Span::from_millis(250);
    let exchange = |one_way: Span| Exchange {
        sent,
        received: sent + one_way + clock_ahead,
        replied: sent + one_way + clock_ahead,
        returned: sent + one_way + one_way,
        uncertainty: Span::from_nanos(2),
    };
    let delays = DelaySecond {
        count: 5,
        median: Some(DelayPoint {
            value: Span::from_millis(4),
            bounds: micros(4_000 - width, 4_000 + width),
            bits_per_second: Some(300e6),
        }),
        verdict: Verdict::Ok,
    };
    ClockSample {
        peer,
        peer_name: "cloud".parse().expect("a name"),
        at,
        // SQLite stores this number as a negative number, because its integers are signed.
        relation_period: u64::MAX - 7,
        max_drift_ppm: 50.0,
        upper: Some(exchange(Span::from_micros(width))),
        lower: Some(exchange(Span::from_micros(width + 1))),
        offset: Some(Offset {
            at,
            estimate: clock_ahead,
            bounds: micros(250_000 - width, 250_000 + width),
            source: DelaySource::Intersection,
            sources: vec![
                (DelaySource::InBand, micros(250_000 - width, 250_000 + 2 * width)),
                (DelaySource::Chrony, micros(250_000 - 2 * width, 250_000 + width)),
            ],
            verdict: Verdict::Ok,
            skew_ppm: Some(-12.5),
            exchanges: 17,
            age: Some(Span::from_millis(80)),
        }),
        probes: ProbeCounts { sent: 10, answered: 9, lost: 1, refused: 0 },
        exchanges: ExchangeCounts { accepted: 9, impossible: 1, outliers: 2, stepped: 3, restarts: 4 },
        round_trip: Some(RoundTrip {
            min: Span::from_micros(2 * width),
            median: Span::from_micros(3 * width),
        }),
        up: Some(delays),
        down: Some(DelaySecond { count: 4, verdict: Verdict::Limited, ..delays }),
        network: NetworkName::default(),
        basis: None,
    }
}

/// Returns a link as an agent reports it.
pub fn link(latest_sample: ClockSample) -> LinkLive {
    LinkLive {
        peer: latest_sample.peer,
        peer_name: latest_sample.peer_name.clone(),
        networks: vec!["zmq-tcp".into()],
        pipelines: vec!["line".parse().expect("a name")],
        same_clock: false,
        probing: Probing::On {
            address: "udp://127.0.0.1:8620".into(),
            rate_hz: 10.0,
            stamps: "kernel, receive only".into(),
        },
        edge: Some(HostClock { text: "not synchronised".into(), ..HostClock::default() }),
        cloud: None,
        latest_sample,
        connections: Vec::new(),
        reflector: None,
    }
}
