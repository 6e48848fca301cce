//! Rows that go in and come out.

mod columns;

use super::*;
use crate::testing::rows as made;

#[test]
fn rows_are_read_back_unchanged() {
    let mut rows = made(40);
    rows[3].values.push((Column::Owned("grip".to_owned()), 0.5));
    (rows[20].at, rows[20].iteration, rows[20].episode) = (0.0, 7, 3);
    let kept: Rows = rows.iter().cloned().collect();
    assert_eq!(kept.len(), 40);
    for (kept, row) in kept.iter().zip(&rows) {
        assert_eq!(kept.to_row(), *row);
        assert_eq!(
            (kept.is_in_statistics(), kept.value("upload-lo")),
            (row.is_in_statistics(), row.value("upload-lo"))
        );
        assert_eq!(kept.verdicts()[1], row.download.map(|delay| delay.verdict));
    }
    assert_eq!(kept.get(5).and_then(|row| row.reason()), Some("the connection broke, \"reset\""));
    assert!(kept.get(40).is_none() && kept.last().is_some_and(|row| row.iteration() == 40));
}

#[test]
fn statistics_exclude_warm_up_and_failed_rows() {
    let rows: Rows = made(9).into_iter().collect();
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
fn different_rows_are_not_equal() {
    let all = |change: fn(&mut Row)| {
        let mut rows = made(3);
        change(&mut rows[1]);
        rows.into_iter().collect::<Rows>()
    };
    let same = all(|_| ());
    assert_eq!(same, all(|_| ()));
    for change in [
        (|row| row.values[0].1 += 1e-9) as fn(&mut Row),
        |row| row.outcome = Outcome::Timeout,
        |row| row.reason = Some("x".to_owned()),
        |row| row.values.push((Column::Owned("grip".to_owned()), 0.5)),
    ] {
        assert_ne!(same, all(change));
    }
}
