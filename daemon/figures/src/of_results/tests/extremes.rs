//! Tests of figures of numbers that are extremely large or small.

use super::*;

const TIMES: [&str; 6] = ["sensing", "upload", "inference", "download", "total", "stages-total"];
const OTHER_COLUMNS: [&str; 5] =
    ["upload-bytes", "upload-logger-bytes", "download-bytes", "top-1", "x-tokens"];

/// Returns a run in which all measurements are `extreme` from row `from` on.
fn with_extremes(extreme: f64, from: u64) -> Loaded {
    let mut run = run(60, |number| {
        let ordinary = TIMES.map(|name| (name, 10.0)).into_iter();
        let ordinary = ordinary.chain(OTHER_COLUMNS.map(|name| (name, (1 + number % 4) as f64)));
        ordinary.map(|(name, value)| (name, if number >= from { extreme } else { value })).collect()
    });
    let remote = placed("m", "remote", 1.0).record;
    run.record = RunRecord {
        model: remote.model,
        placement: remote.placement,
        experiment: remote.experiment,
        ..run.record
    };
    run
}

#[test]
fn figures_of_extreme_numbers_are_written_or_lack_data() {
    let local = placed("m", "local", 7.0);
    for (value, from) in [(f64::MAX, 1), (-1e308, 50), (f64::INFINITY, 50), (1e-300, 1), (1e18, 50)] {
        let runs = [with_extremes(value, from), local.clone()];
        let folder = tempfile::tempdir().expect("a folder");
        for kind in Kind::ALL {
            let drawn = draw(kind, &runs, &Columns::default(), folder.path());
            assert!(!matches!(drawn, Err(PlotError::Write(_))), "{kind:?} of {value}: {drawn:?}");
        }
    }
}

#[test]
fn values_too_large_to_draw_are_left_out_and_noted() {
    let partly_extreme = with_extremes(1e308, 51);
    let drawn =
        series::drawings(&partly_extreme.record, &partly_extreme.rows).expect("most numbers can be drawn");
    let AnyFigure::TimeSeries(time_series) = &drawn[0].figure else { panic!("{drawn:?}") };
    // Of the first 50 rows, row 7 has no values.
    assert_eq!(time_series.total.values.len(), 49);
    assert!(
        time_series.notes.contains(&"not drawn, beyond ±1e18: 10 numbers".to_owned()),
        "{:?}",
        time_series.notes
    );
    let drawn =
        payload::drawings(std::slice::from_ref(&partly_extreme)).expect("the other numbers can be drawn");
    let AnyFigure::Scaling(scaling) = &drawn[0].figure else { panic!("{drawn:?}") };
    assert!(scaling.notes.iter().any(|note| note.contains("±1e18")), "{:?}", scaling.notes);
    let all_extreme = with_extremes(1e308, 1);
    let missing = histograms::drawings(&all_extreme, Some("upload")).expect_err("no number can be drawn");
    assert_eq!(missing, MissingData::Column("upload".to_owned()));
}
