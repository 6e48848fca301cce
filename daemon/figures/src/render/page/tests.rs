//! Tests of plots on pages.

use super::*;
use crate::look::{Mark, Style, TextStyle, stage};
use crate::plot::{Axis, Path};
use crate::scale::Scale;

fn tick(at: f64, text: &str) -> Tick {
    Tick { value: at, at, text: text.to_owned() }
}

/// Returns the labels that are shown in a picture of `width` rem.
fn shown_at(html: &str, width: u16) -> Vec<&str> {
    let labels = html.split("<text class=\"fits w").skip(1);
    let shown = labels.filter(|label| {
        let min_width: u16 = label.split('"').next().and_then(|text| text.parse().ok()).expect("a width");
        min_width <= width
    });
    shown.filter_map(|label| label.split('>').nth(1)?.split('<').next()).collect()
}

#[test]
fn labels_that_would_touch_are_hidden() {
    let ticks: Vec<Tick> = (1..=4).map(|n| tick(f64::from(n) * 0.2, &format!("{n}00,000"))).collect();
    let html = axis("xaxis", &ticks);
    assert_eq!(shown_at(&html, 18), ["100,000", "200,000", "300,000", "400,000"]);
    assert_eq!(shown_at(&html, 10), ["100,000", "300,000"], "{html}");
}

#[test]
fn labels_at_ends_stay_within_picture() {
    let ends = axis_within("xaxis", &[0.0, 0.5, 1.0].map(|at| tick(at, "0.04")));
    let anchors: Vec<&str> =
        ends.split("text-anchor=\"").skip(1).filter_map(|rest| rest.split('"').next()).collect();
    assert_eq!(anchors, ["start", "middle", "end"]);
}

#[test]
fn page_has_classes_and_percentages_without_colours() {
    let x = Axis::new(Scale::linear((0.0, 10.0)).widened(5), "Upload, ms", "ms");
    let y = Axis::new(Scale::logarithmic((1.0, 100.0)), "Iterations", "").with_grid();
    let mut plot = Plot::new(x, y);
    plot.items.push(Item::rect(plot.at(2.0, 1.0), plot.at(4.0, 10.0), stage("upload").plain().bin()));
    plot.items.push(Item::path(Path::line([Some((0.0, 0.5)), Some((1.0, 0.25))]), Style::halo()));
    plot.items.push(Item::mark(plot.at(5.0, 10.0), Mark::Triangle, 3.0, Style::ink()));
    plot.items.push(Item::line(
        plot.at(5.0, 10.0).offset_by(3.0, 0.0),
        plot.at(5.0, 100.0).offset_by(3.0, 0.0),
        Style::whisker(),
    ));
    plot.items.push(Item::Text(Label::new(plot.at(5.0, 10.0), "<5>", TextStyle::MARK).shifted(0.7, 0.36)));
    plot.remark = Some("3 beyond".to_owned());
    let html = super::plot(&plot, "plot-with-axes", "a description");
    for part in [
        "<div class=\"plot-with-axes\" role=\"img\" aria-label=\"a description\">",
        "<span class=\"above\" aria-hidden=\"true\">logarithmic</span>",
        "<rect class=\"bin f-upload\" x=\"20%\" y=\"50%\" width=\"20%\" height=\"50%\"/>",
        "<path class=\"halo\" d=\"M0 500L1000 250\"/>",
        "<svg class=\"at\" x=\"50%\" y=\"50%\"><path class=\"f-ink\"",
        "<svg class=\"at\" x=\"50%\" y=\"0%\"><line class=\"whisk2\" x1=\"4\" x2=\"4\" y1=\"50%\" y2=\"0%\"/></svg>",
        "<text class=\"marktext\" x=\"50%\" y=\"50%\" dx=\"0.7em\" dy=\"0.36em\" text-anchor=\"start\">&lt;5&gt;</text>",
        "<text class=\"beyond\" x=\"100%\" y=\"0%\" dy=\"-0.4em\" text-anchor=\"end\">3 beyond</text>",
        "<span class=\"below\" aria-hidden=\"true\">ms</span></div>",
    ] {
        assert!(html.contains(part), "{part} is not in {html}");
    }
    assert!(!html.contains("style=") && !html.contains('#') && !html.contains("fill=\""), "{html}");
}

#[test]
fn text_is_shown_only_where_it_fits() {
    let min_width = |share: f64, text: &str| {
        Label::new(At::new(0.5, 0.5), text, TextStyle::ON_PALE).with_max_width(share).min_width
    };
    assert_eq!((min_width(0.2, "2.6"), min_width(0.001, "2.6")), (Some(8), None));
    assert!(min_width(0.075, "2.6") > min_width(0.2, "2.6"));
    let hidden = Label::new(At::new(0.5, 0.5), "2.6", TextStyle::ON_PALE).with_max_width(0.001);
    assert!(!picture(&[Item::Text(hidden)], "stages", "").contains("2.6"));
}
