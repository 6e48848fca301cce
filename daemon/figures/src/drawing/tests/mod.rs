//! Figures as drawn: what stands in the SVG, and where.

mod bars;
mod over_time;
mod pairs;
mod points;
mod sharing;

use std::collections::HashMap;

use super::*;
use peernet_analysis::order::Ordered;

/// The elements of a kind in an SVG: their attributes.
struct Elements(Vec<HashMap<String, String>>);

impl Elements {
    fn of(svg: &str, tag: &str) -> Self {
        let element = |text: &str| -> HashMap<String, String> {
            let head = text.split('>').next().unwrap_or_default();
            let parts: Vec<&str> = head.split('"').collect();
            let pairs = parts.chunks_exact(2);
            pairs.map(|pair| (pair[0].trim().trim_end_matches('=').to_owned(), pair[1].to_owned())).collect()
        };
        Self(svg.split(&format!("<{tag} ")).skip(1).map(element).collect())
    }

    /// Those with a value of an attribute, whatever the case.
    fn with(mut self, attribute: &str, value: &str) -> Self {
        self.0
            .retain(|element| element.get(attribute).is_some_and(|found| found.eq_ignore_ascii_case(value)));
        self
    }

    fn numbers(&self, attribute: &str) -> Vec<f64> {
        self.0.iter().map(|element| element[attribute].parse().expect("a number")).collect()
    }
}

/// The texts of an SVG.
fn texts(svg: &str) -> Vec<String> {
    let parts = svg.split("<text ").skip(1).filter_map(|part| part.split('>').nth(1)?.split('<').next());
    parts.map(|text| text.trim().to_owned()).collect()
}

fn has(svg: &str, wanted: &str) -> bool {
    texts(svg).iter().any(|text| text == wanted)
}

fn colour(fill: Fill) -> String {
    format!("#{:02x}{:02x}{:02x}", fill.colour.0, fill.colour.1, fill.colour.2)
}

fn millis(values: impl IntoIterator<Item = f64>) -> Ordered {
    values.into_iter().map(|value| value / 1e3).collect()
}

/// No number of a figure is lost between the layout and the paper: all that is drawn lies on it.
fn assert_on_paper(figure: &impl Figure, svg: &str) {
    let (width, height) = figure.size();
    for (tag, along, across) in [("rect", "x", "y"), ("circle", "cx", "cy"), ("text", "x", "y")] {
        let elements = Elements::of(svg, tag);
        let inside =
            |values: Vec<f64>, most: u32| values.iter().all(|value| (0.0..=f64::from(most)).contains(value));
        assert!(inside(elements.numbers(along), width), "{tag} {along} in {svg}");
        assert!(inside(elements.numbers(across), height), "{tag} {across} in {svg}");
    }
    assert!(Elements::of(svg, "rect").numbers("width").iter().all(|width| *width >= 0.0));
    assert!(Elements::of(svg, "rect").numbers("height").iter().all(|height| *height >= 0.0));
    assert!(!svg.contains("NaN") && !svg.contains("\"inf"), "{svg}");
}

#[test]
fn a_figure_is_as_wide_as_a_column_in_both_files() {
    let folder = tempfile::tempdir().expect("a folder");
    let figure = bars::histogram(millis((0..100).map(f64::from)));
    let [png, svg] = figure.write(folder.path(), "some-time").expect("written");
    let bytes = std::fs::read(&png).expect("is there");
    let density = bytes.windows(4).position(|name| name == b"pHYs").expect("says how large its pixels are");
    let metre = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().expect("four"));
    let per_inch = [4, 8].map(|at| (f64::from(metre(density + at)) * 0.0254).round());
    assert_eq!((per_inch, bytes[density + 12]), ([480.0; 2], 1), "to the metre");
    let picture = image::open(&png).expect("a picture");
    assert_eq!((picture.width(), picture.height()), figure.size());
    let svg = std::fs::read_to_string(svg).expect("read");
    assert!(svg.starts_with("<svg width=\"3.5in\" height=\"2.625in\" viewBox=\"0 0 1680 1260\""), "{svg}");
    assert!(svg.contains("font-family=\"Inter, Helvetica, Arial, sans-serif\""), "{svg}");
    let missing = folder.path().join("missing");
    let error = figure.write(&missing, "some-time").expect_err("there is no such folder");
    assert!(error.to_string().contains("some-time.png"), "{error}");
}

#[test]
fn names_cannot_break_a_file() {
    let figure = Histogram {
        title: "a\tb\n<c> & \u{1b}[2J\u{0}\u{7}".to_owned(),
        ..bars::histogram(millis([1.0, 2.0]))
    };
    let svg = figure.svg().expect("drawn");
    assert!(svg.contains("a b &lt;c&gt; &amp;  [2J"), "{svg}");
    assert!(!svg.chars().any(|char| char.is_control() && char != '\n'), "{svg}");
    assert_on_paper(&figure, &svg);
}
