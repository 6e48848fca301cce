//! Tests that intervals from summaries equal the intervals from single values. The dashboard's pages show intervals from
//! stored summaries. The files of results have the values of single iterations.

use peernet_statistics::Sketch;

use super::*;

fn summary(values: impl Iterator<Item = f64>) -> Summary {
    let mut summary = Summary::default();
    values.for_each(|value| summary.record(value));
    summary
}

/// Delay with the ends of its interval, seconds.
type Delay = (f64, f64, f64);

/// Returns the two intervals from single values and the two intervals from summaries: first the interval of the median
/// delay, then the interval of the median throughput. The message with the delay `delays[index]` has `bits(index)` bits.
fn intervals(delays: &[Delay], bits: impl Fn(usize) -> f64) -> ([Option<(f64, f64)>; 2], [ClockInterval; 2]) {
    let throughputs = delays.iter().enumerate().map(|(index, (value, lo, hi))| {
        let rate = |seconds: f64| if seconds > 0.0 { bits(index) / seconds } else { f64::INFINITY };
        (rate(*value), rate(*hi), rate(*lo))
    });
    let throughputs: Vec<Delay> = throughputs.collect();
    let interval_of_values = |all: &[Delay]| median_bounds(all.iter().map(|(_, lo, hi)| Some((*lo, *hi))));
    let ends = |all: &[Delay]| [summary(all.iter().map(|one| one.1)), summary(all.iter().map(|one| one.2))];
    let values = |all: &[Delay]| summary(all.iter().map(|one| one.0));
    let half_widths = summary(delays.iter().map(|(_, lo, hi)| (hi - lo) / 2.0));
    let (delay_values, delay_ends) = (values(delays), ends(delays));
    let of_delays = ClockedSummaries {
        values: &delay_values,
        ends: Some(&delay_ends),
        delays: &delay_values,
        half_widths: Some(&half_widths),
    };
    let (rates, rate_ends) = (values(&throughputs), ends(&throughputs));
    let of_throughputs = ClockedSummaries { values: &rates, ends: Some(&rate_ends), ..of_delays };
    let from_summaries =
        [of_delays.interval_of_median_delay(), of_throughputs.interval_of_median_throughput()];
    (
        [interval_of_values(delays), interval_of_values(&throughputs)],
        from_summaries.map(|interval| interval.expect("all have intervals")),
    )
}

fn assert_equal_intervals(delays: &[Delay], bits: impl Fn(usize) -> f64) -> [ClockInterval; 2] {
    let (from_values, from_summaries) = intervals(delays, bits);
    for (from_values, from_summaries) in from_values.into_iter().zip(from_summaries) {
        let from_values = from_values.expect("all have bounds");
        let near = |a: f64, b: f64| a == b || (a - b).abs() <= Sketch::RELATIVE_ERROR * b.abs();
        assert!(
            near(from_summaries.lo, from_values.0) && near(from_summaries.hi, from_values.1),
            "{from_values:?} {from_summaries:?}"
        );
        assert_eq!(from_summaries.method, IntervalMethod::Ends);
    }
    from_summaries
}

/// Returns a pseudo-random number from 0 to 1.
fn pseudo_random(number: usize) -> f64 {
    (number * 379 % 1_001) as f64 / 1_001.0
}

#[test]
fn summaries_and_values_give_equal_interval_with_zero_bounds() {
    // Two fifths of the lower ends are 0, the widths differ by a factor of ten, and no value is in the middle of its
    // interval.
    let delay_with_ends = |number| {
        let value = 0.4e-3 + 2e-3 * pseudo_random(number);
        let width = 0.2e-3 + 2e-3 * pseudo_random(7 * number + 3);
        let lo = if number % 5 < 2 { 0.0 } else { (value - 0.1 * width).max(0.0) };
        (value, lo, value + 0.9 * width)
    };
    let delays: Vec<Delay> = (0..1_000).map(delay_with_ends).collect();
    let bits = |number: usize| 8.0 * (10e3 + 90e3 * pseudo_random(3 * number + 1));
    let [of_delays, of_throughputs] = assert_equal_intervals(&delays, bits);
    assert!(of_delays.lo > 0.0 && of_throughputs.hi.is_finite());
    // Ends that are estimated from half widths differ from these ends.
    let values = summary(delays.iter().map(|one| one.0));
    let half_widths = summary(delays.iter().map(|(_, lo, hi)| (hi - lo) / 2.0));
    let without_ends =
        ClockedSummaries { values: &values, ends: None, delays: &values, half_widths: Some(&half_widths) };
    let estimated = without_ends.interval_of_median_delay().expect("half widths");
    assert_eq!(estimated.method, IntervalMethod::HalfWidths);
    assert!((estimated.hi / of_delays.hi - 1.0).abs() > 0.1, "{estimated:?} {of_delays:?}");
    assert_eq!(estimated.method.remark(), Some("from half widths"));
    // All lower ends of the delays are zero, so the upper ends of the throughputs are infinite.
    let with_zero_ends: Vec<Delay> = delays.iter().map(|(value, _, hi)| (*value, 0.0, *hi)).collect();
    let [of_delays, of_throughputs] = assert_equal_intervals(&with_zero_ends, bits);
    assert_eq!((of_delays.lo, of_throughputs.hi), (0.0, f64::INFINITY));
}

#[test]
fn summaries_and_values_give_equal_interval_with_negative_delays() {
    let observed = |number| {
        let value = -0.3e-3 + 0.05e-3 * pseudo_random(number);
        (value, value - 0.5e-3, value + 0.4e-3)
    };
    let delays: Vec<Delay> = (0..301).map(observed).collect();
    let from_values = median_bounds(delays.iter().map(|(_, lo, hi)| Some((*lo, *hi)))).expect("bounds");
    let (_, [from_summaries, _]) = intervals(&delays, |_| 8.0);
    assert!(
        (from_summaries.lo / from_values.0 - 1.0).abs() < 0.01
            && (from_summaries.hi / from_values.1 - 1.0).abs() < 0.01,
        "{from_values:?} {from_summaries:?}"
    );
    assert!(from_summaries.lo < -0.7e-3);
    // Only the interval of a negative delay has a negative lower end.
    assert_eq!(ClockInterval::from_half_width(-0.25, 0.5).ends(), (-0.75, 0.25));
    assert_eq!(ClockInterval::from_half_width(1.0, 4.0).ends(), (0.0, 5.0));
}

#[test]
fn delay_without_bounds_leaves_median_without_interval() {
    assert_eq!(
        [median_bounds([Some((0.0, 1.0)), None].into_iter()), median_bounds(std::iter::empty())],
        [None, None]
    );
    // One of 40 delays has no interval.
    let (delays, of_39_delays) = (summary([1e-3; 40].into_iter()), summary([1e-4; 39].into_iter()));
    let ends = [of_39_delays.clone(), of_39_delays.clone()];
    let incomplete = ClockedSummaries {
        values: &delays,
        ends: Some(&ends),
        delays: &delays,
        half_widths: Some(&of_39_delays),
    };
    let intervals = (incomplete.interval_of_median_delay(), incomplete.interval_of_median_throughput());
    assert_eq!(intervals, (None, None));
    // An earlier version, which recorded no ends, stored the first part of the run. All delays have half widths.
    let with_half_widths = ClockedSummaries { half_widths: Some(&delays), ..incomplete };
    let intervals =
        [with_half_widths.interval_of_median_delay(), with_half_widths.interval_of_median_throughput()];
    assert_eq!(
        intervals.map(|interval| interval.map(|interval| interval.method)),
        [Some(IntervalMethod::HalfWidths); 2]
    );
}
