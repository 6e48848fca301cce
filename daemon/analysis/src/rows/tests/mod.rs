//! Tests of rows that are appended and read back.

mod columns;

use peernet_clock::{OneWayDelay, Span};

use super::*;
use crate::testing::{row_of_values, rows as test_rows};

#[test]
fn rows_are_read_back_unchanged() {
    let mut rows = test_rows(40);
    rows[3].values.push((Column::Owned("grip".to_owned()), 0.5));
    (rows[20].at, rows[20].iteration, rows[20].episode) = (0.0, 7, 3);
    let appended: Rows = rows.iter().cloned().collect();
    assert_eq!(appended.len(), 40);
    for (read_back, row) in appended.iter().zip(&rows) {
        assert_eq!(read_back.to_row(), *row);
        assert_eq!(
            (read_back.is_in_statistics(), read_back.value("upload-lo")),
            (row.is_in_statistics(), row.value("upload-lo"))
        );
        assert_eq!(read_back.verdicts()[1], row.download.map(|delay| delay.verdict));
    }
    assert_eq!(appended.get(5).and_then(|row| row.reason()), Some("the connection broke, \"reset\""));
    assert!(appended.get(40).is_none() && appended.last().is_some_and(|row| row.iteration() == 40));
}

#[test]
fn statistics_exclude_warm_up_and_failed_rows() {
    let rows: Rows = test_rows(9).into_iter().collect();
    assert_eq!(
        rows.values_in_statistics("upload").collect::<Vec<_>>(),
        [3, 4, 5, 7, 8, 9].map(|n| f64::from(17_000 + n) / 1e6)
    );
    assert_eq!(
        (rows.values_in_statistics("inference_pre").count(), rows.values_in_statistics("nothing").count()),
        (6, 0)
    );
}

#[test]
fn sent_message_without_delay_has_unknown_delay() {
    let row = |values: &[(&'static str, f64)]| row_of_values(Outcome::Ok, values);
    let rows: Rows = [
        row(&[("upload", 1.0), ("upload-bytes", 9.0)]),
        row(&[("upload-bytes", 9.0)]),
        Row { upload: Some(OneWayDelay::unsynchronised(Span::from_millis(3))), ..row(&[]) },
        row(&[("upload-bytes", 0.0)]),
    ]
    .into_iter()
    .collect();
    let is_unknown: Vec<bool> = rows.iter().map(|row| row.has_unknown_delay("upload")).collect();
    assert_eq!(is_unknown, [false, true, true, false]);
    assert!(rows.iter().all(|row| !row.has_unknown_delay("download")));
}

#[test]
fn different_rows_are_not_equal() {
    let rows_after = |change: fn(&mut Row)| {
        let mut rows = test_rows(3);
        change(&mut rows[1]);
        rows.into_iter().collect::<Rows>()
    };
    let unchanged = rows_after(|_| ());
    assert_eq!(unchanged, rows_after(|_| ()));
    for change in [
        (|row| row.values[0].1 += 1e-9) as fn(&mut Row),
        |row| row.outcome = Outcome::Timeout,
        |row| row.reason = Some("x".to_owned()),
        |row| row.values.push((Column::Owned("grip".to_owned()), 0.5)),
    ] {
        assert_ne!(unchanged, rows_after(change));
    }
}
