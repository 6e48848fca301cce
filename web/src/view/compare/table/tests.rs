use peernet_stream::PlacementKind::{Local, Remote};

use super::super::spread::boxes;
use super::super::tests::{comparison, configuration, course};
use super::*;

/// A sensor alone: 24 and 16 µs.
fn fast() -> Comparison {
    comparison(vec![configuration(0, Local, 1.5e-3, 1e3), configuration(1, Remote, 1e-3, 1e3)])
}

#[test]
fn differences_of_microseconds_have_digits_and_an_interval_that_is_not_nothing() {
    let both = fast();
    let (a, b) = (vec![course(24.1e-6, 20)], vec![course(16.0e-6, 20)]);
    let found = difference((&both.configurations[0], &a), (&both.configurations[1], &b));
    let (_, total, changed) = &found[0];
    assert_eq!(changed.certain, Some(true));
    assert!(changed.difference.starts_with("\u{2212}0.0080"), "{changed:?}");
    let interval = changed.interval.as_deref().expect("an interval");
    let ends: Vec<&str> = interval.split(" to ").collect();
    assert!(ends[0] != ends[1] && ends.iter().all(|end| end.starts_with("\u{2212}0.0080")), "{interval}");
    let text = title(&both, total.as_ref());
    assert!(
        text.starts_with("B takes 0.0080") && text.contains("less than A (95\u{202f}%: 0.0080"),
        "{text}"
    );
}

#[test]
fn titles_and_boxes_have_the_digits_of_the_table() {
    let both = fast();
    let cell = &Table::of(&both).rows[1].cells;
    let column = Table::of(&both).header.columns.iter().position(|name| *name == "total").expect("a total");
    assert!(cell[column].0.starts_with("0.01"), "{cell:?}");
    assert_eq!(title(&both, None), "B has the smaller mean, 0.0160\u{202f}ms");
    let (rows, _) = boxes(&both);
    let ends: Vec<&str> = rows[1].quartiles.split(" – ").collect();
    assert_ne!(ends[0], ends[1], "{:?}", rows[1].quartiles);
    assert!(rows[1].median.starts_with("0.01") && rows[1].median.len() == 6, "{}", rows[1].median);
    assert!(rows[1].picture.to_string().contains(&format!("median {}\u{202f}ms", rows[1].median)));
}
