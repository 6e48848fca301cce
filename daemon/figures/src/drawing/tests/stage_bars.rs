//! Tests of bars of stages and of the small pictures in tables.

use super::super::{StageBar, StagePart, meter, share_bar, sparkline};
use crate::plot::{Item, Path};
use crate::render::page;
use crate::scale::Scale;

fn part(name: &str, milliseconds: f64) -> StagePart {
    StagePart { name: name.to_owned(), seconds: milliseconds / 1e3, bound: None }
}

fn html(bar: &StageBar<'_>) -> String {
    page::picture(&bar.items(), "stages", "")
}

/// Returns the left and the right end of each horizontal line of a class. Caps are vertical.
fn horizontal_lines(bar: &StageBar<'_>, class: &str) -> Vec<[f64; 2]> {
    let horizontal_line = |item: Item| match item {
        Item::Line { from, to, style } if style.class == class && from.x != to.x => Some([from.x, to.x]),
        _ => None,
    };
    bar.items().into_iter().filter_map(horizontal_line).collect()
}

/// Returns whether two lists of ends are equal except for rounding.
fn are_close(a: &[[f64; 2]], b: &[[f64; 2]]) -> bool {
    let are_ends_close = |(a, b): (&[f64; 2], &[f64; 2])| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
    a.len() == b.len() && a.iter().zip(b).all(are_ends_close)
}

/// Returns the minimum width of a picture in which each value is shown; `None` for a value that is never shown.
fn min_widths(bar: &StageBar<'_>) -> Vec<Option<u16>> {
    let text = |item: Item| if let Item::Text(label) = item { Some(label.min_width) } else { None };
    bar.items().into_iter().filter_map(text).collect()
}

#[test]
fn stage_shows_value_and_name_where_they_fit() {
    let parts = [part("sensing", 2.0), part("preprocessing", 2.6), part("inference", 13.1)];
    let bar = html(&StageBar::new(&parts, Scale::up_to(30.0, 6)));
    assert!(bar.contains("<tspan class=\"fits w12\">inference </tspan>13.1<"), "{bar}");
    assert!(bar.contains("<text class=\"o-preprocessing fits w"), "{bar}");
    assert!(bar.contains("<rect class=\"f-preprocessing edge\""), "a pale fill has no edge: {bar}");
    let hostile = [part("<script>", 9.0)];
    assert!(!html(&StageBar::new(&hostile, Scale::up_to(10.0, 5))).contains("<script>"));
    let without_values = StageBar { has_values: false, ..StageBar::new(&parts, Scale::up_to(30.0, 6)) };
    assert!(!html(&without_values).contains("<text"), "a bar without values has text");
}

#[test]
fn percentile_whiskers_begin_at_end_of_bar() {
    let parts = [part("upload", 20.0)];
    let with = |quantiles| StageBar { quantiles, ..StageBar::new(&parts, Scale::up_to(30.0, 6)) };
    let both = with([Some(0.024), Some(0.027)]);
    assert!(are_close(&horizontal_lines(&both, "whisk"), &[[2.0 / 3.0, 0.8]]), "{both:?}");
    assert!(are_close(&horizontal_lines(&both, "whisk far"), &[[0.8, 0.9]]), "{both:?}");
    assert!(horizontal_lines(&with([Some(0.019), None]), "whisk").is_empty());
    let beyond = with([Some(0.9), None]);
    assert!(
        are_close(&horizontal_lines(&beyond, "whisk"), &[[2.0 / 3.0, 1.0]])
            && html(&beyond).contains(">→</text>")
    );
}

#[test]
fn clock_bounds_are_drawn_at_boundary_to_other_host() {
    let bounded = |name: &str, milliseconds, bound: f64| StagePart {
        bound: Some(bound / 1e3),
        ..part(name, milliseconds)
    };
    let parts = [bounded("upload", 15.0, 3.0), part("inference", 6.0), bounded("download", 3.0, 6.0)];
    let bar = StageBar::new(&parts, Scale::up_to(30.0, 6));
    // The bound of the download is longer than the delay. Its whisker is cut off on each side at a delay of zero.
    assert!(
        are_close(&horizontal_lines(&bar, "whisk2"), &[[0.4, 0.6], [0.6, 0.8]]),
        "{:?}",
        horizontal_lines(&bar, "whisk2")
    );
    let narrow_bound = [bounded("upload", 15.0, 0.01)];
    assert!(horizontal_lines(&StageBar::new(&narrow_bound, Scale::up_to(30.0, 6)), "whisk2").is_empty());
}

#[test]
fn values_under_whisker_of_total_are_hidden() {
    let parts = [part("sensing", 10.0), part("inference", 10.0)];
    let with = |mean_and_std| StageBar { mean_and_std, ..StageBar::new(&parts, Scale::up_to(30.0, 6)) };
    assert_eq!(min_widths(&with(None)), [Some(8), Some(8)]);
    assert_eq!(min_widths(&with(Some((0.020, 0.001)))), [Some(8), Some(8)]);
    let with_close_whisker = min_widths(&with(Some((0.020, 0.004))));
    assert!(with_close_whisker[0] == Some(8) && with_close_whisker[1] > Some(20), "{with_close_whisker:?}");
    let long_whisker = with(Some((0.020, 0.025)));
    assert_eq!(
        (horizontal_lines(&long_whisker, "whisk2"), min_widths(&long_whisker)),
        (vec![[0.0, 1.0]], vec![None, None])
    );
}

#[test]
fn full_width_bar_fills_picture() {
    let parts = [part("sensing", 5.0), part("inference", 15.0)];
    let bar = html(&StageBar::full_width(&parts));
    assert!(bar.contains("<rect class=\"f-inference\" x=\"25%\" y=\"15%\" width=\"75%\""), "{bar}");
    assert!(!bar.contains("gridl") && !html(&StageBar::full_width(&[])).contains("NaN"), "{bar}");
}

#[test]
fn meter_has_minimum_and_maximum_length() {
    let width = |share| match meter(share).last() {
        Some(Item::Rect { to, .. }) => to.x,
        other => panic!("{other:?}"),
    };
    assert_eq!([0.0, 0.001, 0.5, 7.0, f64::NAN].map(width), [0.0, 0.02, 0.5, 1.0, 0.0]);
}

#[test]
fn full_share_bar_leaves_room_for_its_number() {
    let bar = page::picture(&share_bar("upload", 1.0), "sharebar", "");
    // The bar of the share 1 ends at 72 % of the picture. The number begins 2 % of the picture after the bar.
    assert!(bar.contains("width=\"72%\"") && bar.contains("x=\"74%\""), "{bar}");
}

#[test]
fn missing_value_interrupts_sparkline() {
    let paths = |values: &[Option<f64>]| {
        let path = |item| if let Item::Path { path, .. } = item { path } else { Path::default() };
        sparkline(values).into_iter().map(path).collect::<Vec<_>>()
    };
    let [area, line] = &paths(&[Some(0.0), Some(1.0), None, Some(0.5), Some(2.0)])[..] else { panic!() };
    let points = [Some((0.0, 1.0)), Some((0.25, 0.0)), None, Some((0.75, 0.5)), Some((1.0, 0.0))];
    assert_eq!((line, area), (&Path::line(points), &Path::area(points)));
    assert!(paths(&[None, None]).iter().chain(&paths(&[])).all(Path::is_empty));
}
