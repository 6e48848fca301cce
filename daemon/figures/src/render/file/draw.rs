//! Draws the items of a plot as SVG elements of a file, with literal attributes.

use super::SMALL;
use super::places::Area;
use crate::look::{Mark, Rgb, Stroke, Style, WHITE, lines};
use crate::plot::{Anchor, At, Item, Label, Path, Step};
use crate::svg::{Attributes, Tag, Writer, append_number};

/// Width of the lines of a hatch, points.
const HATCH_LINE_WIDTH: f64 = 0.45;
/// Width of the rim around text, points.
const RIM: f64 = 1.6;

/// Draws items. Each item is drawn over the items before it.
pub(super) fn items(svg: &mut Writer, items: &[Item], area: &Area) {
    for item in items {
        match item {
            Item::Rect { from, to, min_size, style } => {
                rect(svg, with_min_size([area.point(*from), area.point(*to)], *min_size), style);
            }
            Item::Line { from, to, style } => line(svg, [area.point(*from), area.point(*to)], style),
            Item::Path { path, style } if !path.is_empty() => {
                let shape = styled(svg.element(Tag::Path), style).set("d", path_data(path, area));
                shape.set("stroke-linejoin", "round").set("stroke-linecap", "round").leaf();
            }
            Item::Path { .. } => {}
            Item::Mark { at, mark, radius, style } => point(svg, area.point(*at), (*mark, *radius), style),
            Item::Text(label) => draw_label(svg, label, area),
        }
    }
}

/// Returns the left upper and the right lower corner of a rectangle. A rectangle that is narrower than the minimum is
/// extended to the right. A rectangle that is lower than the minimum is extended upwards.
fn with_min_size([a, b]: [(f64, f64); 2], (min_width, min_height): (f64, f64)) -> [(f64, f64); 2] {
    let (left, right) = (a.0.min(b.0), a.0.max(b.0));
    let (top, bottom) = (a.1.min(b.1), a.1.max(b.1));
    [(left, top.min(bottom - min_height)), (right.max(left + min_width), bottom)]
}

/// Draws a rectangle with its hatch.
pub(super) fn rect(svg: &mut Writer, corners: [(f64, f64); 2], style: &Style) {
    let [(left, top), (right, bottom)] = corners;
    let background = styled(svg.element(Tag::Rect), style).set("x", left).set("y", top);
    background.set("width", right - left).set("height", bottom - top).leaf();
    if let Some((hatch, colour)) = style.fill.and_then(|fill| fill.hatch) {
        let hatch_lines = lines(corners, hatch);
        if !hatch_lines.is_empty() {
            let path_data: String = hatch_lines.into_iter().map(|line| line_data(&line)).collect();
            let path = svg.element(Tag::Path).set("d", path_data).set("fill", "none");
            path.set("stroke", colour).set("stroke-width", HATCH_LINE_WIDTH).leaf();
        }
    }
}

/// Returns the attribute `d` of a path that is a straight line.
fn line_data(line: &[(f64, f64); 2]) -> String {
    let mut out = String::new();
    append_command(&mut out, 'M', line[0]);
    append_command(&mut out, 'L', line[1]);
    out
}

/// Draws a straight line.
pub(super) fn line(svg: &mut Writer, [from, to]: [(f64, f64); 2], style: &Style) {
    let line = styled(svg.element(Tag::Line), style).set("x1", from.0).set("y1", from.1);
    line.set("x2", to.0).set("y2", to.1).leaf();
}

/// Draws a mark.
pub(super) fn point(svg: &mut Writer, (x, y): (f64, f64), (mark, radius): (Mark, f64), style: &Style) {
    if mark == Mark::Disc {
        return styled(svg.element(Tag::Circle), style).set("cx", x).set("cy", y).set("r", radius).leaf();
    }
    styled(svg.element(Tag::Path), style).set("d", super::super::outline(mark, (x, y), radius)).leaf();
}

fn draw_label(svg: &mut Writer, label: &Label, area: &Area) {
    let (x, y) = area.point(label.at);
    let (x, y) = (x + label.shift.0 * SMALL, y + label.shift.1 * SMALL);
    let element = svg.element(Tag::Text).set("x", x).set("y", y).set("font-size", SMALL);
    let mut element = element.set("fill", label.style.colour);
    if label.style.has_halo {
        element = element.set("stroke", WHITE).set("stroke-width", RIM).set("stroke-linejoin", "round");
        // The rim is painted first, so that it does not cover the letters.
        element = element.set("paint-order", "stroke");
    }
    anchored(element, label.anchor).text(&label.text);
}

/// Writes a line of text. The start, the middle or the end of its baseline lies at a point.
pub(super) fn text(
    svg: &mut Writer,
    content: &str,
    (x, y): (f64, f64),
    (size, colour, anchor): (f64, Rgb, Anchor),
) {
    let element = svg.element(Tag::Text).set("x", x).set("y", y).set("font-size", size).set("fill", colour);
    anchored(element, anchor).text(content);
}

fn anchored(element: Attributes<'_>, anchor: Anchor) -> Attributes<'_> {
    element.set_optional("text-anchor", (anchor != Anchor::Start).then_some(anchor.name()))
}

/// Adds the fill and the stroke of a shape.
fn styled<'a>(element: Attributes<'a>, style: &Style) -> Attributes<'a> {
    let element = match style.fill {
        Some(fill) => {
            let opacity = (fill.opacity < 1.0).then_some(fill.opacity);
            element.set("fill", fill.colour).set_optional("fill-opacity", opacity)
        }
        None => element.set("fill", "none"),
    };
    match style.stroke {
        Some(Stroke { colour, width, dash }) => {
            let dash = dash.map(|(dash, gap)| format!("{dash} {gap}"));
            element.set("stroke", colour).set("stroke-width", width).set_optional("stroke-dasharray", dash)
        }
        None => element,
    }
}

/// Returns the attribute `d` of a path.
fn path_data(path: &Path, area: &Area) -> String {
    let mut out = String::with_capacity(path.steps.len() * 12);
    let point = |x: f64, y: f64| area.point(At::new(x, y).offset_by(path.dx, 0.0));
    for step in &path.steps {
        match step {
            Step::Move(x, y) => append_command(&mut out, 'M', point(*x, *y)),
            Step::Line(x, y) => append_command(&mut out, 'L', point(*x, *y)),
            Step::Close => out.push('Z'),
        }
    }
    out
}

/// Appends a command of the attribute `d` with its point.
fn append_command(out: &mut String, command: char, (x, y): (f64, f64)) {
    out.push(command);
    // A hundredth of a point is finer than a pixel of the PNG.
    append_number(out, x, 2);
    out.push(' ');
    append_number(out, y, 2);
}
