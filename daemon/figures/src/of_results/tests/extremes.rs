//! Tests of impossible numbers.

use super::*;

const TIMES: [&str; 6] = ["sensing", "upload", "inference", "download", "total", "stages-total"];
const OTHERS: [&str; 5] = ["upload-bytes", "upload-logger-bytes", "download-bytes", "top-1", "x-tokens"];

/// Returns a run all of whose measurements are `odd` from row `from` on.
fn odd(odd: f64, from: u64) -> Loaded {
    let mut run = run(60, |number| {
        let ordinary = TIMES.map(|name| (name, 10.0)).into_iter();
        let ordinary = ordinary.chain(OTHERS.map(|name| (name, (1 + number % 4) as f64)));
        ordinary.map(|(name, value)| (name, if number >= from { odd } else { value })).collect()
    });
    let place = placed("m", "remote", 1.0).record;
    run.record = RunRecord {
        model: place.model,
        placement: place.placement,
        experiment: place.experiment,
        ..run.record
    };
    run
}

#[test]
fn extreme_numbers_give_valid_figures_of_all_kinds() {
    let here = placed("m", "local", 7.0);
    for (value, from) in [(f64::MAX, 1), (-1e308, 50), (f64::INFINITY, 50), (1e-300, 1), (1e18, 50)] {
        let runs = [odd(value, from), here.clone()];
        let folder = tempfile::tempdir().expect("a folder");
        for kind in Kind::ALL {
            let drawn = draw(kind, &runs, &Columns::default(), folder.path());
            assert!(!matches!(drawn, Err(PlotError::Write(_))), "{kind:?} of {value}: {drawn:?}");
        }
    }
}

#[test]
fn implausibly_large_values_are_excluded_and_noted() {
    let some = odd(1e308, 51);
    let drawn = series::drawings(&some.record, &some.rows).expect("most can be drawn");
    let AnyFigure::TimeSeries(time_series) = &drawn[0].figure else { panic!("{drawn:?}") };
    assert_eq!(time_series.total.values.len(), 49);
    assert!(
        time_series.notes.contains(&"not drawn, beyond ±10¹⁸: 10 numbers".to_owned()),
        "{:?}",
        time_series.notes
    );
    let drawn = payload::drawings(std::slice::from_ref(&some)).expect("the others can be drawn");
    let AnyFigure::Scaling(scaling) = &drawn[0].figure else { panic!("{drawn:?}") };
    assert!(scaling.notes.iter().any(|note| note.contains("±10¹⁸")), "{:?}", scaling.notes);
    let all = odd(1e308, 1);
    let refused = histograms::drawings(&all, Some("upload")).expect_err("there is none");
    assert_eq!(refused, MissingData::Column("upload".to_owned()));
}
