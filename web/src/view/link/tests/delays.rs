//! Tests of the combination of the delays of several seconds.

use peernet_clock::Interval;
use peernet_stream::{DelayPoint, DelaySecond};

use super::super::*;

fn second(count: u32, value_ms: f64, verdict: Verdict) -> DelaySecond {
    let value = Span::from_seconds_f64(value_ms / 1e3);
    let median = DelayPoint { value, bounds: Interval::exactly(value), bits_per_second: None };
    DelaySecond { count, median: Some(median), verdict }
}

#[test]
fn median_weighs_delays_and_ignores_rare_verdicts() {
    let many = [second(98, 6.0, Verdict::Ok), second(1, 60.0, Verdict::Ok), second(1, 1.0, Verdict::Stepped)];
    let all = Delays::merge(Direction::Up, &many);
    assert_eq!((all.value().as_str(), all.verdict, all.count), ("6.00", Some(Verdict::Ok), 100));
    let worse =
        Delays::merge(Direction::Up, &[second(90, 6.0, Verdict::Ok), second(10, 6.0, Verdict::Stale)]);
    assert_eq!(worse.verdict, Some(Verdict::Stale));
}

#[test]
fn negative_bound_of_delay_is_not_shown() {
    let mut low = second(10, 0.2, Verdict::Limited);
    low.median = low.median.map(|point| DelayPoint {
        bounds: Interval { lo: Span::from_micros(-450), hi: Span::from_micros(850) },
        ..point
    });
    assert_eq!(Delays::merge(Direction::Down, &[low]).interval().as_deref(), Some("0.00 – 0.85"));
}
