//! Tests of kinds of figures that both pages and files have, drawn by the renderer of pages.

use super::*;
use crate::look::{Mark, Style};
use crate::plot::{Anchor, At, Item, Label};
use crate::render::page;
use crate::scale::Scale;

/// Asserts that the HTML has no inline style and no colour, because both come from the style sheet,
/// and that all numbers in the HTML are finite.
fn assert_valid_for_page(html: &str) {
    for forbidden in [" style=", "fill=\"", "stroke=\"", "#", "NaN", "\"inf"] {
        assert!(!html.contains(forbidden), "{forbidden} is in {html}");
    }
}

#[test]
fn page_distribution_has_bars_and_lines() {
    let figure = bars::histogram(millis((0..1000).map(f64::from).chain([9e5, 1e6]))).figure();
    let html = page::plot(&figure.plots[0], "plot-with-axes", "a description");
    assert_valid_for_page(&html);
    assert!(html.matches("class=\"bin f-upload\"").count() >= 8, "{html}");
    for part in ["class=\"mark median\"", "class=\"mark p95\"", ">median 500 ms<", "2 beyond 999 ms →"] {
        assert!(html.contains(part), "{part} is not in {html}");
    }
}

#[test]
fn lengths_and_scaling_are_drawn_on_page() {
    let points = (0..3000).map(|i| (f64::from(i % 83), f64::from(i % 83) * 2e-3)).collect();
    let unit = Unit { title: "Tokens".to_owned(), symbol: "".into(), per_si: 1.0 };
    let (title, notes, stage) = (String::new(), Vec::new(), "inference".to_owned());
    let lengths =
        Lengths { title, x: unit, y: Unit::milliseconds("Inference"), stage, points, line: None, notes };
    let html = page::plot(&lengths.figure().plots[0], "joint", "a description");
    assert_valid_for_page(&html);
    assert!(html.contains("class=\"over\"") && html.contains("class=\"beside\""), "{html}");
    assert!(html.contains("<path class=\"f-inference\""), "{html}");
    let value = |bytes: f64| Value {
        bytes,
        value: bytes * 1e-7,
        p5_and_p95: None,
        bounds: Some((bytes * 6e-8, None)),
    };
    let scaling = Scaling {
        title: String::new(),
        unit: Unit::milliseconds("Delay"),
        explanations: Explanations { point: "a", whisker: "b", line: "c" },
        notes: Vec::new(),
        series: vec![Series {
            name: "upload".to_owned(),
            stage: "upload",
            mark: Mark::Triangle,
            values: [1e3, 1e4].map(value).to_vec(),
            line: Some((1e-5, 1e-7)),
        }],
    };
    let figure = scaling.figure();
    let html = page::plot(&figure.plots[0], "plot-with-axes", "a description");
    assert_valid_for_page(&html);
    assert!(html.contains("<path class=\"g-upload fit\" d=\"M"), "{html}");
    assert_eq!(html.matches("class=\"f-upload\"").count(), 2, "{html}");
    let legend = page::legend(&figure.legend, "key plain points");
    assert!(legend.contains("<li class=\"extra\">") && legend.ends_with("upload</li></ul>"), "{legend}");
}

#[test]
fn stack_values_are_labelled_if_they_fit() {
    let scale = Scale::linear((0.0, 40.0)).widened(6);
    let stack = Stack { parts: vec![("sensing", 3.0), ("encode", 0.02), ("upload", 9.0)], scale };
    let mut items = stack.items((0.15, 0.85), Orientation::Horizontal);
    for (name, from, to) in stack.segments() {
        let middle = At::new(scale.at(f64::midpoint(from, to)), 0.5);
        let label =
            Label::new(middle, format!("{:.1}", to - from), stage(name).text()).anchored(Anchor::Middle);
        items.push(Item::Text(label.with_max_width(scale.at(to) - scale.at(from))));
    }
    let has_caps = [true; 2];
    items.extend(Orientation::Horizontal.whisker(
        [0.3, 0.4].map(|at| At::new(at, 0.5)),
        has_caps,
        4.0,
        &Style::whisker(),
    ));
    let html = page::picture(&items, "stages", "a description");
    assert_valid_for_page(&html);
    assert!(html.contains("<rect class=\"f-encode edge\""), "{html}");
    assert!(html.contains("<text class=\"o-upload fits w") && !html.contains(">0.0<"), "{html}");
}
