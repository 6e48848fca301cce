//! Tests of figures in files.

use super::super::export::ParsedFigure;
use super::*;
use crate::look::{Mark, Style, TextStyle, series, stage};
use crate::plot::{Axis, Height, Item, Key, Label, Marks, Path, Plot, Strip, Swatch, Table};
use crate::scale::{Scale, Tick};

fn figure() -> Figure {
    let x = Axis::new(Scale::linear((0.0, 10.0)), "Upload, ms", "ms");
    let y = Axis::new(Scale::logarithmic((1.0, 100.0)), "Iterations", "").with_grid();
    let mut plot = Plot::new(x, y);
    plot.items.push(Item::rect(plot.at(2.0, 1.0), plot.at(4.0, 10.0), stage("queue").area()));
    plot.items.push(Item::path(Path::line([Some((0.0, 0.5)), Some((1.0, 0.25))]), series(1).line(0.75)));
    plot.items.push(Item::mark(plot.at(5.0, 10.0), Mark::Triangle, 2.0, Style::ink()));
    plot.items.push(Item::Text(Label::new(plot.at(5.0, 10.0), "<5>", TextStyle::MARK)));
    plot.top_strip = Some(Strip {
        items: vec![Item::rect(Default::default(), Default::default(), Style::total())],
        size: 9.0,
    });
    plot.remark = Some("3 beyond 10 ms →".to_owned());
    Figure {
        title: "Upload time · robot → cloud".to_owned(),
        legend: vec![Key::new(Swatch::Area(stage("queue").area()), "queue")],
        notes: vec![
            "configurations: model · n = 1,200 (600 each)".to_owned(),
            "left out: 5 warm-up".to_owned(),
        ],
        plots: vec![plot],
        table: Table {
            titles: vec!["p95, ms".to_owned()],
            lines: vec![("small".to_owned(), vec!["9.1".to_owned()])],
        },
    }
}

#[test]
fn figure_has_column_width_and_one_line_caption() {
    let svg = svg(&figure());
    assert!(svg.contains("width=\"3.5in\"") && svg.contains("viewBox=\"0 0 252 "), "{svg}");
    assert!(svg.contains(">Upload time · robot → cloud · n = 1,200 (600 each)<"), "{svg}");
    assert!(svg.contains(">Iterations (log scale)<") && svg.contains(">&lt;5&gt;<"), "{svg}");
    assert!(!svg.contains("left out") && !svg.contains("class="), "{svg}");
    let caption = figure().caption_text();
    for line in ["Upload time · robot → cloud", "left out: 5 warm-up", "Legend: queue", "3 beyond 10 ms →"]
    {
        assert!(caption.lines().any(|other| other == line), "{line} is not in {caption}");
    }
}

#[test]
fn no_text_is_smaller_than_seven_points() {
    let svg = svg(&figure());
    let sizes: Vec<f64> = svg
        .split("font-size=\"")
        .skip(1)
        .map(|rest| rest.split('"').next().and_then(|size| size.parse().ok()).expect("a size"))
        .collect();
    assert!(!sizes.is_empty() && sizes.iter().all(|size| *size >= 7.0), "{sizes:?}");
}

#[test]
fn second_plot_lies_below_the_first() {
    let mut figure = figure();
    let mut lower = figure.plots[0].clone();
    (lower.height, lower.top_strip) = (Height::Points(30.0), None);
    figure.plots.push(lower);
    let areas = areas(&figure);
    assert_eq!(areas[0].left, areas[1].left, "both plots have the same left end");
    assert_eq!(areas[1].height, 30.0);
    // Labels and titles between and below the plots need more than 20 points.
    assert!(areas[0].bottom() + 20.0 < areas[1].top && areas[0].height > 60.0, "{areas:?}");
    let height = places::Places::of(&figure).height;
    assert!(areas[1].bottom() + 20.0 < height - table::height(&figure.table), "{areas:?} {height}");
}

#[test]
fn picture_grows_with_fixed_height_of_plot() {
    let names = |count: usize| {
        let tick = |row: usize| Tick {
            value: 0.0,
            at: row as f64 / count as f64,
            text: format!("configuration {row}"),
        };
        Marks::Names((0..count).map(tick).collect())
    };
    let picture_height = |count: usize| {
        let scale = Scale::linear((0.0, 1.0));
        let mut plot =
            Plot::new(Axis::new(scale, "Latency, ms", "ms"), Axis::new(scale, "", "").marked(names(count)));
        plot.height = Height::Points(count as f64 * 14.0);
        places::Places::of(&Figure { plots: vec![plot], ..Figure::default() }).height
    };
    assert_eq!(picture_height(20) - picture_height(10), 140.0);
}

#[test]
fn name_with_invalid_xml_characters_is_drawn() {
    let figure = Figure { title: "a\u{fffe}b\u{ffff}c\u{7}d".to_owned(), ..figure() };
    let svg = svg(&figure);
    assert!(svg.contains(">a b c d · n"), "{svg}");
    ParsedFigure::of(&svg).expect("a valid SVG");
}

#[test]
fn long_title_of_horizontal_axis_stays_in_picture() {
    // Returns the title and the two ends of its line.
    let drawn = |title: &str| {
        let mut figure = figure();
        title.clone_into(&mut figure.plots[0].x.title);
        // The middle of the plot is to the left of the middle of the picture.
        figure.plots[0].free_right = 100.0;
        let svg = svg(&figure);
        let element = svg.split("<text ").find(|text| text.contains(">Inference")).expect("a title");
        let middle = element.split('"').nth(1).and_then(|x| x.parse::<f64>().ok()).expect("a number");
        let text = element.split(['>', '<']).nth(1).expect("a text").to_owned();
        let half_width = crate::text::width(&text, TEXT) / 2.0;
        (text, middle - half_width, middle + half_width)
    };
    let nested = format!("Inference {}, ms", "postprocessing ".repeat(9));
    let (text, left, right) = drawn(&nested);
    assert!(text.contains('…') && text.ends_with(", ms"), "{text}");
    assert!(left >= 0.0 && right <= WIDTH, "{left} {right}");
    // This title is narrower than the picture, but wider than twice the distance from the middle of the plot to the
    // left edge of the picture.
    let title = format!("Inference {}, ms", "n".repeat(34));
    let (text, left, right) = drawn(&title);
    assert_eq!(text, title);
    assert!(left >= 0.0 && right <= WIDTH, "{left} {right}");
}

#[test]
fn png_states_resolution_and_pdf_contains_font() {
    let parsed = ParsedFigure::of(&svg(&figure())).expect("an SVG");
    let pixels = parsed.pixels().expect("drawn");
    assert_eq!(pixels.width, 1_680);
    let dark = pixels.rgb.chunks(3).filter(|pixel| pixel.iter().all(|channel| *channel < 0x50)).count();
    assert!(dark > 2_000, "text is missing: {dark} dark pixels");
    let png = parsed.png().expect("made");
    // The chunk with the resolution follows the signature and the header, which have 33 bytes.
    assert!(png.starts_with(b"\x89PNG") && png[33..].starts_with(b"\0\0\0\x09pHYs"));
    let pdf = parsed.pdf().expect("made");
    let has = |wanted: &[u8]| pdf.windows(wanted.len()).any(|bytes| bytes == wanted);
    assert!(pdf.starts_with(b"%PDF") && has(b"Inter"), "the font is missing");
    assert!(has(b"/MediaBox [0 0 252"), "the page is not 252 points wide");
}
