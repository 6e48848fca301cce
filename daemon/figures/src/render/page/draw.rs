//! Draws the items of a plot as SVG elements of a page.

use crate::look::{Mark, Style};
use crate::plot::{At, Item, Label, Path, Step};
use crate::svg::{Attributes, Em, Share, Tag, Writer, append_number};

/// Width and height of the `viewBox` of paths.
const VIEW_BOX: f64 = 1_000.0;
/// Pixels per point.
const PIXELS_PER_POINT: f64 = 96.0 / 72.0;

/// Draws items. Each item is drawn over the items before it. Consecutive paths share one nested `<svg>`.
pub(super) fn draw_items(svg: &mut Writer, items: &[Item]) {
    let is_path = |item: &Item| matches!(item, Item::Path { .. });
    for consecutive in items.chunk_by(|a, b| is_path(a) && is_path(b)) {
        if is_path(&consecutive[0]) {
            draw_paths(svg, consecutive);
        } else {
            draw_item(svg, &consecutive[0]);
        }
    }
}

/// Draws paths in a nested `<svg>` whose `viewBox` is stretched over the plot, because the attribute `d` cannot contain
/// percentages.
fn draw_paths(svg: &mut Writer, paths: &[Item]) {
    let nested =
        svg.element(Tag::Svg).set("class", "sheet").set("width", Share(1.0)).set("height", Share(1.0));
    nested.set("viewBox", "0 0 1000 1000").set("preserveAspectRatio", "none").open();
    for path in paths {
        if let Item::Path { path, style } = path
            && !path.is_empty()
        {
            styled(svg.element(Tag::Path), style).set("d", path_data(path)).leaf();
        }
    }
    svg.close();
}

/// Returns the attribute `d` of a path.
fn path_data(path: &Path) -> String {
    let mut out = String::with_capacity(path.steps.len() * 12);
    for step in &path.steps {
        let (command, x, y) = match step {
            Step::Move(x, y) => ('M', x, y),
            Step::Line(x, y) => ('L', x, y),
            Step::Close => {
                out.push('Z');
                continue;
            }
        };
        out.push(command);
        // One decimal is a ten-thousandth of the plot, which is finer than a pixel.
        append_number(&mut out, x * VIEW_BOX, 1);
        out.push(' ');
        append_number(&mut out, y * VIEW_BOX, 1);
    }
    out
}

fn draw_item(svg: &mut Writer, item: &Item) {
    match item {
        Item::Rect { from, to, style, .. } => {
            let (x, y) = (from.x.min(to.x), from.y.min(to.y));
            let rect = styled(svg.element(Tag::Rect), style).set("x", Share(x)).set("y", Share(y));
            rect.set("width", Share((to.x - from.x).abs()))
                .set("height", Share((to.y - from.y).abs()))
                .leaf();
        }
        Item::Line { from, to, style } => draw_line(svg, [*from, *to], style),
        Item::Path { .. } => draw_paths(svg, std::slice::from_ref(item)),
        Item::Mark { at, mark, radius, style } => {
            draw_mark(svg, *at, (*mark, radius * PIXELS_PER_POINT), style);
        }
        Item::Text(label) => draw_label(svg, label),
    }
}

/// Opens a nested `<svg>` whose origin is at a place, which is given as shares of the plot. Lengths in the nested
/// `<svg>` are pixels. Items that extend beyond the nested `<svg>` are visible.
fn open_at(svg: &mut Writer, x: f64, y: f64) {
    svg.element(Tag::Svg).set("class", "at").set("x", Share(x)).set("y", Share(y)).open();
}

/// Draws a line. If an end has an offset in points (`dx`, `dy`), the line is drawn in a nested `<svg>`, because one
/// attribute cannot add a share and an offset. Offsets in the direction of an upright or horizontal line are ignored.
/// All offsets of a slanted line are ignored.
fn draw_line(svg: &mut Writer, [from, to]: [At; 2], style: &Style) {
    let has_offset = [from, to].iter().any(|at| at.dx != 0.0 || at.dy != 0.0);
    if !has_offset {
        let line = styled(svg.element(Tag::Line), style).set("x1", Share(from.x)).set("x2", Share(to.x));
        line.set("y1", Share(from.y)).set("y2", Share(to.y)).leaf();
        return;
    }
    let (upright, horizontal) = (from.x == to.x, from.y == to.y);
    open_at(svg, if upright { from.x } else { 0.0 }, if horizontal { from.y } else { 0.0 });
    let mut line = styled(svg.element(Tag::Line), style);
    line = if upright {
        line.set("x1", from.dx * PIXELS_PER_POINT).set("x2", to.dx * PIXELS_PER_POINT)
    } else {
        line.set("x1", Share(from.x)).set("x2", Share(to.x))
    };
    line = if horizontal {
        line.set("y1", from.dy * PIXELS_PER_POINT).set("y2", to.dy * PIXELS_PER_POINT)
    } else {
        line.set("y1", Share(from.y)).set("y2", Share(to.y))
    };
    line.leaf();
    svg.close();
}

fn draw_mark(svg: &mut Writer, at: At, (mark, radius): (Mark, f64), style: &Style) {
    let has_offset = at.dx != 0.0 || at.dy != 0.0;
    if mark == Mark::Disc && !has_offset {
        let disc = styled(svg.element(Tag::Circle), style).set("cx", Share(at.x)).set("cy", Share(at.y));
        return disc.set("r", radius).leaf();
    }
    open_at(svg, at.x, at.y);
    let (dx, dy) = (at.dx * PIXELS_PER_POINT, at.dy * PIXELS_PER_POINT);
    if mark == Mark::Disc {
        styled(svg.element(Tag::Circle), style).set("cx", dx).set("cy", dy).set("r", radius).leaf();
    } else {
        let outline = super::super::outline(mark, (dx, dy), radius);
        styled(svg.element(Tag::Path), style).set("d", outline).leaf();
    }
    svg.close();
}

/// Draws a label. A label whose minimum width is `None` fits in no picture and is left out.
pub(super) fn draw_label(svg: &mut Writer, label: &Label) {
    let Some(min_width) = label.min_width else { return };
    let has_offset = label.at.dx != 0.0 || label.at.dy != 0.0;
    let width_class =
        |min_width: u16| if min_width > 0 { format!("fits w{min_width}") } else { String::new() };
    let classes = [label.style.class.to_owned(), width_class(min_width)];
    let class = classes.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(" ");
    if has_offset {
        open_at(svg, label.at.x, label.at.y);
    }
    let mut text = svg.element(Tag::Text).set_optional("class", (!class.is_empty()).then_some(class));
    text = if has_offset {
        text.set("x", label.at.dx * PIXELS_PER_POINT).set("y", label.at.dy * PIXELS_PER_POINT)
    } else {
        text.set("x", Share(label.at.x)).set("y", Share(label.at.y))
    };
    text = text.set_optional("dx", (label.shift.0 != 0.0).then_some(Em(label.shift.0)));
    text.set("dy", Em(label.shift.1)).set("text-anchor", label.anchor.name()).open();
    if let Some((prefix, Some(min_width))) = &label.prefix {
        svg.element(Tag::Tspan).set("class", width_class(*min_width)).text(prefix);
    }
    svg.text(&label.text);
    svg.close();
    if has_offset {
        svg.close();
    }
}

/// Adds the class of a style, and the opacity of the style's fill if the opacity is less than 1. The opacity represents
/// a number, so no class can set the opacity.
fn styled<'a>(element: Attributes<'a>, style: &Style) -> Attributes<'a> {
    let opacity = style.fill.map(|fill| fill.opacity).filter(|opacity| *opacity < 1.0);
    element.set("class", &*style.class).set_optional("fill-opacity", opacity)
}
