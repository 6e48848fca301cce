//! Tests that the payload study and a calibration of the same messages have equal figures.

use peernet_analysis::calibration::{Passage, Sample, Setting, Study};
use peernet_clock::{DelaySource, Interval, OneWayDelay, Span, Verdict};

use super::*;
use crate::drawing::Scaling;
use crate::of_calibration::messages;

/// Returns the passage of a message that takes `delay_s` seconds. If `has_bounds`, the bounds are 40 µs below and 40 µs
/// above the delay.
fn passage(payload_bytes: u64, delay_s: f64, has_bounds: bool) -> Passage {
    let [lo, value, hi] = [-40e-6, 0.0, 40e-6].map(|error| Span::from_seconds_f64(delay_s + error));
    let delay = OneWayDelay {
        raw: value,
        value: Some(value),
        bounds: has_bounds.then_some(Interval { lo, hi }),
        source: DelaySource::InBand,
        verdict: Verdict::Ok,
    };
    Passage { payload_bytes, metadata_bytes: 120, delay }
}

/// Asserts that a calibration and a payload study have the same series and the same notes on rates for the same
/// messages. `delay_s` returns the delay of a message, given by its number and the index of its size. Returns the
/// figures of the payload study.
fn assert_equal_figures(
    delay_s: impl Fn(u64, usize) -> f64,
    has_bounds: impl Fn(u64) -> bool,
) -> Vec<Scaling> {
    let sizes = [1_000, 10_000, 100_000, 1_000_000];
    let passages: Vec<Passage> = (0..400)
        .map(|number: u64| {
            let size_index = number as usize % sizes.len();
            passage(sizes[size_index], delay_s(number, size_index), has_bounds(number))
        })
        .collect();
    let samples = passages.iter().zip(1..).map(|(passage, number)| Sample {
        number,
        at: number as f64,
        payload_bytes: passage.payload_bytes,
        warm_up: false,
        outcome: Outcome::Ok,
        reason: None,
        total: None,
        up: Some(*passage),
        down: None,
    });
    let calibration = messages(&Study::new(Setting::default(), samples.collect(), &[]));
    let row = |(passage, iteration): (&Passage, u64)| Row {
        iteration,
        at: 1e9,
        episode: 0,
        step: 0,
        warm_up: false,
        outcome: Outcome::Ok,
        reason: None,
        values: vec![
            ("upload".into(), passage.delay.known_seconds().expect("known")),
            ("upload-bytes".into(), passage.payload_bytes as f64),
            ("upload-logger-bytes".into(), passage.metadata_bytes as f64),
        ],
        upload: Some(passage.delay),
        download: None,
    };
    let record = RunRecord::default();
    let run = Loaded { folder: "results".into(), record, rows: passages.iter().zip(1..).map(row).collect() };
    let drawings = payload::drawings(&[run]).expect("sizes differ");
    let drawn = drawings.iter().map(|drawing| match &drawing.figure {
        AnyFigure::Scaling(figure) => figure.clone(),
        _ => panic!("a figure over sizes"),
    });
    let drawn: Vec<Scaling> = drawn.collect();
    for (drawn, calibrated) in drawn.iter().zip([calibration.latency(), calibration.throughput()]) {
        assert_eq!(
            (&drawn.series[0], &drawn.explanations, &drawn.title),
            (&calibrated.series[0], &calibrated.explanations, &calibrated.title)
        );
        // Only the payload study has a note on the number of messages, which is the first.
        assert_eq!(drawn.notes[1..], calibrated.notes);
    }
    drawn
}

#[test]
fn payload_study_equals_calibration() {
    let variation = |number: u64| (number % 7) as f64 * 1e-6;
    let growing = assert_equal_figures(
        |number, size_index| [0.2, 0.3, 1.2, 10.2][size_index] * 1e-3 + variation(number),
        |_| true,
    );
    assert!(growing[1].series[0].line.is_some() && growing[0].series[0].values[0].bounds.is_some());
    // If some messages have no bounds, the median of all messages has no bounds.
    let unbounded = assert_equal_figures(
        |number, size_index| [0.2, 0.3, 1.2, 10.2][size_index] * 1e-3 + variation(number),
        |number| number > 40,
    );
    assert_eq!(unbounded[0].series[0].values[0].bounds, None);
    // The delays vary more than they grow with the size, so they determine no rate.
    let noisy = assert_equal_figures(
        |number, size_index| [0.2, 0.21, 0.19, 0.22][size_index] * 1e-3 + variation(number),
        |_| true,
    );
    assert_eq!(noisy[1].series[0].line, None);
    assert!(noisy[1].notes[1].starts_with("throughput of upload: too high"), "{:?}", noisy[1].notes);
    // A delay that does not grow with the size has no line.
    let not_growing = assert_equal_figures(
        |number, size_index| [0.2, 0.2, 0.2, 0.1][size_index] * 1e-3 + variation(number),
        |_| true,
    );
    assert!(
        not_growing[0].series[0].name.ends_with("does not grow with size")
            && not_growing[0].series[0].line.is_none()
    );
}
