//! Tests of drawn figures: the elements of the SVG and their positions.

mod bars;
mod curves;
mod over_time;
mod pages;
mod pairs;
mod points;
mod sharing;
mod sketches;
mod stage_bars;
mod stages_over_time;

use std::collections::HashMap;

use super::*;
use crate::look::stage;
use crate::plot::Figure;
use crate::render::{export, file};
use crate::text::{self, missing_glyph};
use peernet_analysis::order::SortedValues;

/// Attributes of each element with one tag in an SVG.
struct Elements(Vec<HashMap<String, String>>);

impl Elements {
    fn of(svg: &str, tag: &str) -> Self {
        let element = |text: &str| -> HashMap<String, String> {
            let head = text.split('>').next().unwrap_or_default();
            let names_and_values: Vec<&str> = head.split('"').collect();
            let pairs = names_and_values.chunks_exact(2);
            pairs.map(|pair| (pair[0].trim().trim_end_matches('=').to_owned(), pair[1].to_owned())).collect()
        };
        Self(svg.split(&format!("<{tag} ")).skip(1).map(element).collect())
    }

    /// Returns the elements whose attribute has this value. Upper and lower case are not distinguished.
    fn with(mut self, attribute: &str, value: &str) -> Self {
        self.0
            .retain(|element| element.get(attribute).is_some_and(|other| other.eq_ignore_ascii_case(value)));
        self
    }

    /// Returns the value of a numeric attribute of each element.
    fn numbers(&self, attribute: &str) -> Vec<f64> {
        self.0.iter().map(|element| element[attribute].parse().expect("a number")).collect()
    }
}

/// Returns the texts of an SVG.
fn texts(svg: &str) -> Vec<String> {
    let elements = svg.split("<text ").skip(1);
    let contents = elements.filter_map(|element| element.split('>').nth(1)?.split('<').next());
    contents.map(|text| text.trim().to_owned()).collect()
}

/// Returns whether an SVG has this text.
fn has_text(svg: &str, wanted: &str) -> bool {
    texts(svg).iter().any(|text| text == wanted)
}

/// Returns the fill colour of a stage in a file.
fn fill_colour(name: &str) -> String {
    stage(name).colour.light.to_string()
}

/// Figure of any kind that can be drawn as a file.
trait Draw {
    fn layout(&self) -> Figure;

    fn svg(&self) -> String {
        file::svg(&self.layout())
    }

    /// Returns the text of the caption's file.
    fn caption_text(&self) -> String {
        self.layout().caption_text()
    }
}

macro_rules! draw {
    ($($kind:ty),*) => {
        $(impl Draw for $kind {
            fn layout(&self) -> Figure {
                self.figure()
            }
        })*
    };
}

draw!(Cumulative, Histogram, Lengths, Paired, QualityAgainstLatency, Scaling, Sharing, Stacked, TimeSeries);

/// Returns values in milliseconds as sorted values in seconds.
fn millis(values: impl IntoIterator<Item = f64>) -> SortedValues {
    values.into_iter().map(|value| value / 1e3).collect()
}

/// Returns the width and the height of a picture, points.
fn picture_size(svg: &str) -> (f64, f64) {
    let size = svg.split("viewBox=\"0 0 ").nth(1).and_then(|rest| rest.split('"').next()).expect("a size");
    let (width, height) = size.split_once(' ').expect("two numbers");
    (width.parse().expect("a number"), height.parse().expect("a number"))
}

/// Asserts that all elements lie in the picture, and that every text fits into the picture, is large enough, and has a
/// glyph in the font for each character.
fn assert_valid_file(svg: &str) {
    let (width, height) = picture_size(svg);
    for (tag, x, y) in [("rect", "x", "y"), ("circle", "cx", "cy"), ("text", "x", "y"), ("line", "x1", "y1")]
    {
        let numbers = |attribute: &str| -> Vec<f64> {
            let elements = Elements::of(svg, tag);
            elements.0.iter().filter_map(|element| element.get(attribute)?.parse().ok()).collect()
        };
        let are_inside = |values: Vec<f64>, max: f64| values.iter().all(|value| (0.0..=max).contains(value));
        assert!(are_inside(numbers(x), width), "{x} of a {tag} is outside of {svg}");
        assert!(are_inside(numbers(y), height), "{y} of a {tag} is outside of {svg}");
    }
    assert!(Elements::of(svg, "rect").numbers("width").iter().all(|width| *width >= 0.0));
    assert!(Elements::of(svg, "rect").numbers("height").iter().all(|height| *height >= 0.0));
    assert!(!svg.contains("NaN") && !svg.contains("\"inf"), "{svg}");
    let sizes = Elements::of(svg, "text").numbers("font-size");
    assert!(sizes.iter().all(|size| *size >= 7.0), "{sizes:?}");
    for (element, text) in Elements::of(svg, "text").0.iter().zip(texts(svg)) {
        assert_eq!(missing_glyph(&text), None, "{text}");
        let number = |name: &str| element[name].parse::<f64>().expect("a number");
        let text_width = text::width(
            &text.replace("&amp;", "&").replace("&lt;", "<").replace("&gt;", ">"),
            number("font-size"),
        );
        let left = match element.get("text-anchor").map(String::as_str) {
            Some("end") => number("x") - text_width,
            Some("middle") => number("x") - text_width / 2.0,
            _ => number("x"),
        };
        let right = left + text_width;
        assert!(left >= -0.5 && right <= width + 0.5, "{text} extends from {left} to {right}");
    }
}

#[test]
fn figure_files_have_column_width_and_resolution() {
    let folder = tempfile::tempdir().expect("a folder");
    let figure = bars::histogram(millis((0..100).map(f64::from)));
    let [png, svg, pdf, txt] = export::write(&figure.figure(), folder.path(), "some-time").expect("written");
    let bytes = std::fs::read(&png).expect("a PNG");
    // The chunk `pHYs` has its name, the horizontal and the vertical resolution, and their unit: 1
    // for pixels per metre.
    let chunk = bytes.windows(4).position(|name| name == b"pHYs").expect("the chunk with the resolution");
    let per_metre = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().expect("four bytes"));
    let per_inch = [4, 8].map(|offset| (f64::from(per_metre(chunk + offset)) * 0.0254).round());
    assert_eq!((per_inch, bytes[chunk + 12]), ([480.0; 2], 1));
    let picture = image::open(&png).expect("a picture");
    assert_eq!((picture.width(), picture.height()), (1_680, 1_260));
    let svg = std::fs::read_to_string(svg).expect("read");
    let begin = "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"3.5in\" height=\"2.625in\" viewBox=\"0 0 252 189\"";
    assert!(svg.starts_with(begin), "{svg}");
    assert!(svg.contains("font-family=\"Inter, Helvetica, Arial, sans-serif\""), "{svg}");
    assert!(std::fs::read(pdf).expect("read").starts_with(b"%PDF"));
    assert!(std::fs::read_to_string(txt).expect("read").contains("Iterations against Upload time, ms"));
    let missing = folder.path().join("missing");
    let error = export::write(&figure.figure(), &missing, "some-time").expect_err("there is no such folder");
    assert!(error.to_string().contains("some-time"), "{error}");
}

#[test]
fn markup_and_control_characters_in_title_are_escaped() {
    let figure = Histogram {
        title: "a\tb\n<c> & \u{1b}[2J\u{0}\u{7}".to_owned(),
        ..bars::histogram(millis([1.0, 2.0]))
    };
    let svg = figure.svg();
    assert!(svg.contains("a b &lt;c&gt; &amp;  [2J"), "{svg}");
    assert!(!svg.chars().any(|char| char.is_control() && char != '\n'), "{svg}");
    assert_valid_file(&svg);
}

/// The font has a glyph for every character in the source files that contain the texts of figures.
#[test]
fn font_has_all_characters_of_figures() {
    for source in [
        include_str!("../quality/mod.rs"),
        include_str!("../time_series/mod.rs"),
        include_str!("../cumulative.rs"),
        include_str!("../histogram/distribution.rs"),
        include_str!("../lengths.rs"),
        include_str!("../paired/mod.rs"),
        include_str!("../scaling.rs"),
        include_str!("../sharing.rs"),
        include_str!("../stacked.rs"),
        include_str!("../../of_calibration.rs"),
        include_str!("../../of_messages.rs"),
        include_str!("../../of_results/accuracy.rs"),
        include_str!("../../of_results/columns.rs"),
        include_str!("../../of_results/cumulative.rs"),
        include_str!("../../of_results/histograms.rs"),
        include_str!("../../of_results/length.rs"),
        include_str!("../../of_results/paired.rs"),
        include_str!("../../of_results/payload.rs"),
        include_str!("../../of_results/replayed.rs"),
        include_str!("../../of_results/series.rs"),
        include_str!("../../of_results/stacked.rs"),
        include_str!("../../of_results/totals.rs"),
        include_str!("../../of_results/users.rs"),
        include_str!("../../../../analysis/src/payload_study.rs"),
    ] {
        assert_eq!(source.lines().find_map(missing_glyph), None);
    }
}
