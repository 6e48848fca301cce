//! Intervals of delays in live windows.

use peernet_analysis::delays::IntervalMethod;
use peernet_logger::stage;
use peernet_statistics::Summary;
use peernet_stream::bound_names;

use super::{Testbed, second};

#[test]
fn window_has_interval_from_reported_ends() {
    // The delays of 6 ms lie near the lower ends of their intervals.
    const DELAYS: [f64; 40] = [6e-3; 40];
    for (ends, method) in [
        (Some([5.5e-3, 7.5e-3]), IntervalMethod::Ends),
        // An agent of an earlier version.
        (None, IntervalMethod::HalfWidths),
    ] {
        let mut testbed = Testbed::new();
        for at in 0..2 {
            let mut second = second(at, &DELAYS, 0);
            let names = bound_names("upload").expect("a delay of a message");
            second.bounds.extend(names.into_iter().zip(ends.into_iter().flatten()).map(|(name, end)| {
                let mut summary = Summary::default();
                DELAYS.iter().for_each(|_| summary.record(end));
                (name, summary)
            }));
            testbed.send(at as f64 + 0.9, vec![second]);
        }
        let snapshot = testbed.snapshot(1.9);
        let window = snapshot.pipelines[0].window(10).expect("a window");
        let delay = window.value(&stage::UPLOAD).expect("delays");
        assert_eq!((window.bounds.len(), delay.count), (1, 80), "the ends are not counted as delays");
        let bound = &window.bounds[0];
        for interval in [bound.interval_of_median(delay), bound.interval_of_mean(delay)] {
            let interval = interval.expect("every delay has an interval");
            // Without ends, the interval follows from the half-widths of 40 µs that `second` reports.
            let [lo, hi] = ends.unwrap_or([6e-3 - 40e-6, 6e-3 + 40e-6]);
            let are_near = |a: f64, b: f64| (a - b).abs() < 1e-9;
            assert!(are_near(interval.lo, lo) && are_near(interval.hi, hi), "{interval:?}");
            assert_eq!(interval.method, method);
        }
    }
}
