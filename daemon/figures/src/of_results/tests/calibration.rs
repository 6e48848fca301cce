//! The payload study and a calibration of the same messages have equal figures.

use peernet_analysis::calibration::Passage;
use peernet_analysis::calibration::{Sample, Setting, Study};
use peernet_clock::{DelaySource, Interval, OneWayDelay, Span, Verdict};

use super::*;
use crate::drawing::Scaling;
use crate::of_calibration::messages;

/// Returns the message of an iteration: `delay_s`, 40 µs to both sides if its bounds are known.
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

/// Asserts that both programs draw the same series and notes on rates for messages with these delays in seconds.
fn assert_equal_figures(
    delay_s: impl Fn(u64, usize) -> f64,
    has_bounds: impl Fn(u64) -> bool,
) -> Vec<Scaling> {
    let sizes = [1_000, 10_000, 100_000, 1_000_000];
    let passages: Vec<Passage> = (0..400)
        .map(|number: u64| {
            let place = number as usize % sizes.len();
            passage(sizes[place], delay_s(number, place), has_bounds(number))
        })
        .collect();
    let samples = passages.iter().zip(1..).map(|(passage, number)| Sample {
        number,
        at: number as f64,
        payload_bytes: passage.payload_bytes,
        warm_up: false,
        outcome: "ok",
        reason: None,
        total: None,
        up: Some(*passage),
        down: None,
    });
    let study = messages(&Study::new(Setting::default(), samples.collect(), &[]));
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
    for (drawn, study) in drawn.iter().zip([study.latency(), study.throughput()]) {
        assert_eq!(
            (&drawn.series[0], &drawn.explanations, &drawn.title),
            (&study.series[0], &study.explanations, &study.title)
        );
        assert_eq!(drawn.notes[1..], study.notes);
    }
    drawn
}

#[test]
fn payload_study_equals_calibration() {
    let late = |number: u64| (number % 7) as f64 * 1e-6;
    let growing =
        assert_equal_figures(|number, place| [0.2, 0.3, 1.2, 10.2][place] * 1e-3 + late(number), |_| true);
    assert!(growing[1].series[0].line.is_some() && growing[0].series[0].values[0].bounds.is_some());
    // Bounds of some messages do not bound the median of all.
    let unbounded = assert_equal_figures(
        |number, place| [0.2, 0.3, 1.2, 10.2][place] * 1e-3 + late(number),
        |number| number > 40,
    );
    assert_eq!(unbounded[0].series[0].values[0].bounds, None);
    // The sizes do not determine a rate, and a delay that does not grow has no line.
    let noisy =
        assert_equal_figures(|number, place| [0.2, 0.21, 0.19, 0.22][place] * 1e-3 + late(number), |_| true);
    assert_eq!((noisy[1].series[0].line, noisy[1].notes.len()), (None, 2));
    let level =
        assert_equal_figures(|number, place| [0.2, 0.2, 0.2, 0.1][place] * 1e-3 + late(number), |_| true);
    assert!(
        level[0].series[0].name.ends_with("does not grow with size") && level[0].series[0].line.is_none()
    );
}
