//! Bars of stages and the small pictures in tables.

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

/// Returns the ends of the level lines of a class that are not caps.
fn lines(bar: &StageBar<'_>, class: &str) -> Vec<[f64; 2]> {
    let level_line = |item: Item| match item {
        Item::Line { from, to, style } if style.class == class && from.x != to.x => Some([from.x, to.x]),
        _ => None,
    };
    bar.items().into_iter().filter_map(level_line).collect()
}

fn close(a: &[[f64; 2]], b: &[[f64; 2]]) -> bool {
    let near = |(a, b): (&[f64; 2], &[f64; 2])| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
    a.len() == b.len() && a.iter().zip(b).all(near)
}

/// Returns the smallest width of a picture at which each value is shown.
fn widths(bar: &StageBar<'_>) -> Vec<Option<u16>> {
    let text = |item: Item| if let Item::Text(label) = item { Some(label.min_width) } else { None };
    bar.items().into_iter().filter_map(text).collect()
}

#[test]
fn stage_shows_value_and_name_where_they_fit() {
    let parts = [part("sensing", 2.0), part("preprocessing", 2.6), part("inference", 13.1)];
    let bar = html(&StageBar::new(&parts, Scale::up_to(30.0, 6)));
    assert!(bar.contains("<tspan class=\"fits w12\">inference </tspan>13.1<"), "{bar}");
    assert!(bar.contains("<text class=\"o-preprocessing fits w"), "{bar}");
    assert!(bar.contains("<rect class=\"f-preprocessing edge\""), "pale fills carry an edge: {bar}");
    let hostile = [part("<script>", 9.0)];
    assert!(!html(&StageBar::new(&hostile, Scale::up_to(10.0, 5))).contains("<script>"));
    let low = StageBar { has_values: false, ..StageBar::new(&parts, Scale::up_to(30.0, 6)) };
    assert!(!html(&low).contains("<text"), "a low bar has no room");
}

#[test]
fn whiskers_begin_at_end_of_bar() {
    let parts = [part("upload", 20.0)];
    let with = |quantiles| StageBar { quantiles, ..StageBar::new(&parts, Scale::up_to(30.0, 6)) };
    let both = with([Some(0.024), Some(0.027)]);
    assert!(close(&lines(&both, "whisk"), &[[2.0 / 3.0, 0.8]]), "{both:?}");
    assert!(close(&lines(&both, "whisk far"), &[[0.8, 0.9]]), "{both:?}");
    assert!(lines(&with([Some(0.019), None]), "whisk").is_empty());
    let beyond = with([Some(0.9), None]);
    assert!(close(&lines(&beyond, "whisk"), &[[2.0 / 3.0, 1.0]]) && html(&beyond).contains(">→</text>"));
}

#[test]
fn clock_bounds_are_drawn_at_boundary_to_other_host() {
    let bounded = |name: &str, milliseconds, bound: f64| StagePart {
        bound: Some(bound / 1e3),
        ..part(name, milliseconds)
    };
    let parts = [bounded("upload", 15.0, 3.0), part("inference", 6.0), bounded("download", 3.0, 6.0)];
    let bar = StageBar::new(&parts, Scale::up_to(30.0, 6));
    // A bound wider than the delay ends where the delay would be nothing.
    assert!(close(&lines(&bar, "whisk2"), &[[0.4, 0.6], [0.6, 0.8]]), "{:?}", lines(&bar, "whisk2"));
    let fine = [bounded("upload", 15.0, 0.01)];
    assert!(lines(&StageBar::new(&fine, Scale::up_to(30.0, 6)), "whisk2").is_empty());
}

#[test]
fn the_totals_whisker_crosses_no_value() {
    let parts = [part("sensing", 10.0), part("inference", 10.0)];
    let with = |mean_and_std| StageBar { mean_and_std, ..StageBar::new(&parts, Scale::up_to(30.0, 6)) };
    assert_eq!(widths(&with(None)), [Some(8), Some(8)]);
    assert_eq!(widths(&with(Some((0.020, 0.001)))), [Some(8), Some(8)]);
    let near = widths(&with(Some((0.020, 0.004))));
    assert!(near[0] == Some(8) && near[1] > Some(20), "{near:?}");
    let wide = with(Some((0.020, 0.025)));
    assert_eq!((lines(&wide, "whisk2"), widths(&wide)), (vec![[0.0, 1.0]], vec![None, None]));
}

#[test]
fn a_whole_bar_fills_its_panel() {
    let parts = [part("sensing", 5.0), part("inference", 15.0)];
    let bar = html(&StageBar::full_width(&parts));
    assert!(bar.contains("<rect class=\"f-inference\" x=\"25%\" y=\"15%\" width=\"75%\""), "{bar}");
    assert!(!bar.contains("gridl") && !html(&StageBar::full_width(&[])).contains("NaN"), "{bar}");
}

#[test]
fn meter_shows_small_shares_and_clamps_large_ones() {
    let width = |share| match meter(share).0.last() {
        Some(Item::Rect { to, .. }) => to.x,
        other => panic!("{other:?}"),
    };
    assert_eq!([0.0, 0.001, 0.5, 7.0, f64::NAN].map(width), [0.0, 0.02, 0.5, 1.0, 0.0]);
    assert!(meter(0.95).1 && !meter(0.5).1);
    let share = page::picture(&share_bar("upload", 1.0), "sharebar", "");
    assert!(share.contains("width=\"72%\"") && share.contains("x=\"74%\""), "{share}");
}

#[test]
fn a_missing_value_parts_a_sparkline() {
    let paths = |values: &[Option<f64>]| {
        let path = |item| if let Item::Path { path, .. } = item { path } else { Path::default() };
        sparkline(values).into_iter().map(path).collect::<Vec<_>>()
    };
    let [area, line] = &paths(&[Some(0.0), Some(1.0), None, Some(0.5), Some(2.0)])[..] else { panic!() };
    let points = [Some((0.0, 1.0)), Some((0.25, 0.0)), None, Some((0.75, 0.5)), Some((1.0, 0.0))];
    assert_eq!((line, area), (&Path::line(points), &Path::area(points)));
    assert!(paths(&[None, None]).iter().chain(&paths(&[])).all(Path::is_empty));
}
