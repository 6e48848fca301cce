//! Intervals from stored statistics equal those from single values.

use peernet_statistics::Sketch;

use super::*;

fn summary(values: impl Iterator<Item = f64>) -> Summary {
    let mut summary = Summary::default();
    values.for_each(|value| summary.record(value));
    summary
}

/// Delay with the ends of its interval, seconds.
type Delay = (f64, f64, f64);

/// Returns the intervals of the median from single values and from stored statistics: of the delays, and of the throughputs of messages of
/// `bits(index)`.
fn intervals(delays: &[Delay], bits: impl Fn(usize) -> f64) -> ([Option<(f64, f64)>; 2], [ClockInterval; 2]) {
    let throughputs = delays.iter().enumerate().map(|(index, (value, lo, hi))| {
        let rate = |seconds: f64| if seconds > 0.0 { bits(index) / seconds } else { f64::INFINITY };
        (rate(*value), rate(*hi), rate(*lo))
    });
    let throughputs: Vec<Delay> = throughputs.collect();
    let file = |all: &[Delay]| median_bounds(all.iter().map(|(_, lo, hi)| Some((*lo, *hi))));
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
    let page = [of_delays.interval_of_median_delay(), of_throughputs.interval_of_median_throughput()];
    ([file(delays), file(&throughputs)], page.map(|interval| interval.expect("all have intervals")))
}

fn assert_equal(delays: &[Delay], bits: impl Fn(usize) -> f64) -> [ClockInterval; 2] {
    let (file, page) = intervals(delays, bits);
    for (file, page) in file.into_iter().zip(page) {
        let file = file.expect("all have bounds");
        let near = |a: f64, b: f64| a == b || (a - b).abs() <= Sketch::RELATIVE_ERROR * b.abs();
        assert!(near(page.lo, file.0) && near(page.hi, file.1), "{file:?} {page:?}");
        assert_eq!(page.method, IntervalMethod::Ends);
    }
    page
}

/// Returns a number from 0 to 1 that looks random.
fn scattered(number: usize) -> f64 {
    (number * 379 % 1_001) as f64 / 1_001.0
}

#[test]
fn page_interval_equals_file_with_cut_and_uneven_bounds() {
    // The lower ends of two fifths are cut at zero, widths differ by a factor of ten, and no value is in the middle.
    let limited = |number| {
        let value = 0.4e-3 + 2e-3 * scattered(number);
        let width = 0.2e-3 + 2e-3 * scattered(7 * number + 3);
        let lo = if number % 5 < 2 { 0.0 } else { (value - 0.1 * width).max(0.0) };
        (value, lo, value + 0.9 * width)
    };
    let delays: Vec<Delay> = (0..1_000).map(limited).collect();
    let sizes = |number: usize| 8.0 * (10e3 + 90e3 * scattered(3 * number + 1));
    let [of_delays, of_throughputs] = assert_equal(&delays, sizes);
    assert!(of_delays.lo > 0.0 && of_throughputs.hi.is_finite());
    // The median of half the widths gives other ends.
    let values = summary(delays.iter().map(|one| one.0));
    let half_widths = summary(delays.iter().map(|(_, lo, hi)| (hi - lo) / 2.0));
    let without_ends =
        ClockedSummaries { values: &values, ends: None, delays: &values, half_widths: Some(&half_widths) };
    let estimated = without_ends.interval_of_median_delay().expect("half widths");
    assert_eq!(estimated.method, IntervalMethod::HalfWidths);
    assert!((estimated.hi / of_delays.hi - 1.0).abs() > 0.1, "{estimated:?} {of_delays:?}");
    assert_eq!(estimated.method.remark(), Some("from half widths"));
    // Most lower ends are zero, so that the upper end of the throughput is infinite.
    let cut: Vec<Delay> = delays.iter().map(|(value, _, hi)| (*value, 0.0, *hi)).collect();
    let [of_delays, of_throughputs] = assert_equal(&cut, sizes);
    assert_eq!((of_delays.lo, of_throughputs.hi), (0.0, f64::INFINITY));
}

#[test]
fn negative_delays_have_interval_of_file() {
    let observed = |number| {
        let value = -0.3e-3 + 0.05e-3 * scattered(number);
        (value, value - 0.5e-3, value + 0.4e-3)
    };
    let delays: Vec<Delay> = (0..301).map(observed).collect();
    let file = median_bounds(delays.iter().map(|(_, lo, hi)| Some((*lo, *hi)))).expect("bounds");
    let (_, [page, _]) = intervals(&delays, |_| 8.0);
    assert!(
        (page.lo / file.0 - 1.0).abs() < 0.01 && (page.hi / file.1 - 1.0).abs() < 0.01,
        "{file:?} {page:?}"
    );
    assert!(page.lo < -0.7e-3);
    assert_eq!(ClockInterval::from_half_width(-0.25, 0.5).ends(), (-0.75, 0.25));
    assert_eq!(ClockInterval::from_half_width(1.0, 4.0).ends(), (0.0, 5.0));
}

#[test]
fn delay_without_bounds_leaves_median_without_interval() {
    assert_eq!(
        [median_bounds([Some((0.0, 1.0)), None].into_iter()), median_bounds(std::iter::empty())],
        [None, None]
    );
    let (delays, of_some) = (summary([1e-3; 40].into_iter()), summary([1e-4; 39].into_iter()));
    let ends = [of_some.clone(), of_some.clone()];
    let some =
        ClockedSummaries { values: &delays, ends: Some(&ends), delays: &delays, half_widths: Some(&of_some) };
    assert_eq!((some.interval_of_median_delay(), some.interval_of_median_throughput()), (None, None));
    // The first part of the run was stored by an earlier version.
    let all = ClockedSummaries { half_widths: Some(&delays), ..some };
    let methods = [all.interval_of_median_delay(), all.interval_of_median_throughput()];
    assert_eq!(methods.map(|one| one.map(|one| one.method)), [Some(IntervalMethod::HalfWidths); 2]);
}
