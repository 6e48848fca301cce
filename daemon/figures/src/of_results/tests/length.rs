//! Tests of the figure of answer lengths.

use super::*;
use crate::of_results::length;

#[test]
fn length_is_counted_in_tokens_if_available() {
    let with_tokens =
        run(60, |number| vec![("inference_tokens", number as f64), ("inference", number as f64 * 80.0)]);
    let drawings = length::drawings(&with_tokens.record, &with_tokens.rows, &Columns::default())
        .expect("there are lengths");
    let AnyFigure::Lengths(figure) = &drawings[0].figure else { panic!("lengths") };
    assert_eq!((figure.points.len(), figure.x.title.as_str()), (54, "Tokens"));
    let note = "no line: a line needs 60 answers, and there are 54";
    assert!(figure.line.is_none() && figure.notes.iter().any(|text| text == note), "{:?}", figure.notes);
    let equal_lengths = run(60, |_| vec![("download-bytes", 96.0), ("inference", 5.0)]);
    let reason = length::drawings(&equal_lengths.record, &equal_lengths.rows, &Columns::default())
        .expect_err("all lengths are equal");
    assert!(reason.to_string().contains("--x"), "{reason}");
    let similar_lengths =
        run(60, |number| vec![("download-bytes", 96.0 + number as f64 % 3.0), ("inference", 5.0)]);
    assert!(length::drawings(&similar_lengths.record, &similar_lengths.rows, &Columns::default()).is_err());
    let named_column = Columns { x: Some("download-bytes".to_owned()), y: None };
    assert!(
        length::drawings(&similar_lengths.record, &similar_lengths.rows, &named_column).is_ok(),
        "a column that was named is drawn"
    );
    let zero_lengths = run(60, |_| vec![("download-bytes", 0.0), ("inference", 5.0)]);
    for columns in [Columns::default(), named_column] {
        let reason = length::drawings(&zero_lengths.record, &zero_lengths.rows, &columns)
            .expect_err("all lengths are zero");
        assert!(reason.to_string().contains("download-bytes is 0 in every iteration"), "{reason}");
    }
}

#[test]
fn missing_usage_is_reported_with_option_to_use() {
    let chunks = |number: u64| vec![("inference_output-chunks", number as f64), ("inference", number as f64)];
    let local = run(200, chunks);
    let folder = tempfile::tempdir().expect("a folder");
    let drawn = |columns: &Columns| draw(Kind::Length, std::slice::from_ref(&local), columns, folder.path());
    let hint = "the server sent no `usage`; use --x output-chunks";
    let error = drawn(&Columns::default()).expect_err("no length").to_string();
    let reason = format!(": the lengths of the answers are not known: {hint}");
    assert!(error.ends_with(&reason), "a local run has no bytes of answers as substitute: {error}");
    let named = Columns { x: Some("output-chunks".to_owned()), y: None };
    assert!(drawn(&named).is_ok(), "the name of a node stands for its column");
    let caption = std::fs::read_to_string(folder.path().join("length-caption.txt")).expect("a caption");
    assert!(!caption.contains(hint), "{caption}");
    let slope = "Each further unit of inference output chunks takes ";
    assert!(caption.contains(slope) && caption.contains("The line begins at "), "{caption}");
    let remote = run(200, |number| [chunks(number), vec![("download-bytes", number as f64)]].concat());
    let drawings =
        length::drawings(&remote.record, &remote.rows, &Columns::default()).expect("bytes of the answers");
    let AnyFigure::Lengths(figure) = &drawings[0].figure else { panic!("lengths") };
    assert!(figure.line.is_some() && figure.notes.iter().any(|text| text == hint), "{:?}", figure.notes);
}

#[test]
fn name_of_several_columns_is_an_error() {
    let with_two_columns = run(60, |number| vec![("a_tokens", number as f64), ("b_tokens", number as f64)]);
    let columns = Columns { x: Some("tokens".to_owned()), y: None };
    let folder = tempfile::tempdir().expect("a folder");
    let error = draw(Kind::Histograms, &[with_two_columns], &columns, folder.path())
        .expect_err("two columns")
        .to_string();
    assert!(error.contains("several columns: a_tokens, b_tokens; name one of them"), "{error}");
}
