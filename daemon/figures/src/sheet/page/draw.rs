//! Items as elements.

use crate::look::{Mark, Style};
use crate::plot::{At, Item, Label, Path, Step};
use crate::svg::{Attributes, Em, Share, Tag, Writer, number};

/// Length of both sides of the sheet of paths, which is stretched over its plot.
const SHEET: f64 = 1_000.0;
/// Pixels of a point.
const PER_POINT: f64 = 96.0 / 72.0;

/// Draws items one over the other; paths that follow upon one another share a sheet.
pub(super) fn items(svg: &mut Writer, all: &[Item]) {
    let is_path = |item: &Item| matches!(item, Item::Path { .. });
    for run in all.chunk_by(|a, b| is_path(a) && is_path(b)) {
        if is_path(&run[0]) {
            stretched(svg, run);
        } else {
            item(svg, &run[0]);
        }
    }
}

/// Draws paths on a sheet that is stretched over the plot.
fn stretched(svg: &mut Writer, paths: &[Item]) {
    let sheet =
        svg.element(Tag::Svg).set("class", "sheet").set("width", Share(1.0)).set("height", Share(1.0));
    sheet.set("viewBox", "0 0 1000 1000").set("preserveAspectRatio", "none").open();
    for path in paths {
        if let Item::Path { path, style } = path
            && !path.is_empty()
        {
            styled(svg.element(Tag::Path), style).set("d", course(path)).leaf();
        }
    }
    svg.close();
}

fn course(path: &Path) -> String {
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
        number(&mut out, x * SHEET, 1);
        out.push(' ');
        number(&mut out, y * SHEET, 1);
    }
    out
}

fn item(svg: &mut Writer, item: &Item) {
    match item {
        Item::Rect { from, to, style, .. } => {
            let (x, y) = (from.x.min(to.x), from.y.min(to.y));
            let rect = styled(svg.element(Tag::Rect), style).set("x", Share(x)).set("y", Share(y));
            rect.set("width", Share((to.x - from.x).abs()))
                .set("height", Share((to.y - from.y).abs()))
                .leaf();
        }
        Item::Line { from, to, style } => line(svg, [*from, *to], style),
        Item::Path { .. } => stretched(svg, std::slice::from_ref(item)),
        Item::Mark { at, mark, radius, style } => point(svg, *at, (*mark, radius * PER_POINT), style),
        Item::Text(text) => label(svg, text),
    }
}

/// Opens a picture at a place, in which lengths are pixels; items beyond its ends are visible.
fn open_at(svg: &mut Writer, x: f64, y: f64) {
    svg.element(Tag::Svg).set("class", "at").set("x", Share(x)).set("y", Share(y)).open();
}

/// Draws a line. If its ends are at distances from their places, it gets a nested picture at the first place.
fn line(svg: &mut Writer, [from, to]: [At; 2], style: &Style) {
    let is_aside = [from, to].iter().any(|at| at.dx != 0.0 || at.dy != 0.0);
    if !is_aside {
        let line = styled(svg.element(Tag::Line), style).set("x1", Share(from.x)).set("x2", Share(to.x));
        line.set("y1", Share(from.y)).set("y2", Share(to.y)).leaf();
        return;
    }
    let (upright, level) = (from.x == to.x, from.y == to.y);
    open_at(svg, if upright { from.x } else { 0.0 }, if level { from.y } else { 0.0 });
    let mut line = styled(svg.element(Tag::Line), style);
    line = if upright {
        line.set("x1", from.dx * PER_POINT).set("x2", to.dx * PER_POINT)
    } else {
        line.set("x1", Share(from.x)).set("x2", Share(to.x))
    };
    line = if level {
        line.set("y1", from.dy * PER_POINT).set("y2", to.dy * PER_POINT)
    } else {
        line.set("y1", Share(from.y)).set("y2", Share(to.y))
    };
    line.leaf();
    svg.close();
}

fn point(svg: &mut Writer, at: At, (mark, radius): (Mark, f64), style: &Style) {
    let is_aside = at.dx != 0.0 || at.dy != 0.0;
    if mark == Mark::Disc && !is_aside {
        let disc = styled(svg.element(Tag::Circle), style).set("cx", Share(at.x)).set("cy", Share(at.y));
        return disc.set("r", radius).leaf();
    }
    open_at(svg, at.x, at.y);
    let (dx, dy) = (at.dx * PER_POINT, at.dy * PER_POINT);
    if mark == Mark::Disc {
        styled(svg.element(Tag::Circle), style).set("cx", dx).set("cy", dy).set("r", radius).leaf();
    } else {
        let outline = super::super::outline(mark, (dx, dy), radius);
        styled(svg.element(Tag::Path), style).set("d", outline).leaf();
    }
    svg.close();
}

/// Draws a text unless it fits in no picture.
pub(super) fn label(svg: &mut Writer, label: &Label) {
    let Some(from) = label.from else { return };
    let is_aside = label.at.dx != 0.0 || label.at.dy != 0.0;
    let fits = |from: u16| if from > 0 { format!("fits w{from}") } else { String::new() };
    let class = [label.style.class.to_owned(), fits(from)];
    let class = class.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(" ");
    if is_aside {
        open_at(svg, label.at.x, label.at.y);
    }
    let mut text = svg.element(Tag::Text).some("class", (!class.is_empty()).then_some(class));
    text = if is_aside {
        text.set("x", label.at.dx * PER_POINT).set("y", label.at.dy * PER_POINT)
    } else {
        text.set("x", Share(label.at.x)).set("y", Share(label.at.y))
    };
    text = text.some("dx", (label.shift.0 != 0.0).then_some(Em(label.shift.0)));
    text.set("dy", Em(label.shift.1)).set("text-anchor", label.anchor.name()).open();
    if let Some((lead, Some(from))) = &label.lead {
        svg.element(Tag::Tspan).set("class", fits(*from)).words(lead);
    }
    svg.words(&label.words);
    svg.close();
    if is_aside {
        svg.close();
    }
}

/// Adds its class, and the attributes that represent a number.
fn styled<'a>(element: Attributes<'a>, style: &Style) -> Attributes<'a> {
    let opacity = style.fill.map(|fill| fill.opacity).filter(|opacity| *opacity < 1.0);
    element.set("class", &*style.class).some("fill-opacity", opacity)
}
