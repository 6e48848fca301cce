//! Sheet of a page: SVG that grows with its panel, looks given by classes.
//!
//! Plots are laid out in a grid of the style sheet (`.histogram`, `.joint`, …) with the classes `above`, `over`, `yaxis`, `plot`,
//! `beside`, `xaxis` and `below`. The server does not know the width of a page, so text that might not fit has the class of its minimum
//! width (`.fits.w8`, …), and the style sheet shows it only from that width on: a clipped figure would be a wrong figure.

mod draw;

use draw::{items, label};

use crate::plot::{Anchor, At, Axis, Item, Key, Label, Plot, Swatch};
use crate::scale::Tick;
use crate::svg::{Em, Share, Tag, Writer};
use crate::text::{rem, width_step};

/// Distance from the top of a plot downwards to the baseline of a remark above it, and of a remark inside if labels are above; in the type
/// size.
const REMARK: [f64; 2] = [-0.4, 0.9];
/// Distance from an end of a plot, as a share, below which a label would extend beyond a plot without room at its sides.
const END: f64 = 0.04;

/// Draws a plot with its axes; `class` is its grid in the style sheet, `words` describe it for screen readers.
pub fn plot(plot: &Plot, class: &str, words: &str) -> String {
    let mut svg = Writer::default();
    svg.element(Tag::Div).set("class", class).set("role", "img").set("aria-label", words).open();
    named(&mut svg, "above", &plot.y);
    if let Some(strip) = &plot.above {
        hidden(&mut svg, Tag::Svg, "over").open();
        items(&mut svg, &strip.items);
        svg.close();
    }
    let (rows, columns) = (plot.y.ticks(usize::MAX), plot.x.ticks(usize::MAX));
    side(&mut svg, "yaxis", &rows);
    hidden(&mut svg, Tag::Svg, "plot").open();
    for tick in rows.iter().filter(|_| plot.y.has_grid) {
        line(&mut svg, "gridl", [0.0, 1.0], [1.0 - tick.at; 2]);
    }
    for tick in columns.iter().filter(|_| plot.x.has_grid) {
        line(&mut svg, "gridl", [tick.at; 2], [0.0, 1.0]);
    }
    items(&mut svg, &plot.items);
    if let Some(remark) = &plot.remark {
        let at = Label::new(At::new(1.0, 0.0), remark.clone(), crate::look::TextStyle::BEYOND);
        label(&mut svg, &at.anchored(Anchor::End).shifted(0.0, REMARK[usize::from(plot.lines_above > 0)]));
    }
    svg.close();
    if let Some(strip) = &plot.beside {
        hidden(&mut svg, Tag::Svg, "beside").open();
        items(&mut svg, &strip.items);
        svg.close();
    }
    row(&mut svg, "xaxis", &columns.iter().map(|tick| (Anchor::Middle, tick)).collect::<Vec<_>>());
    named(&mut svg, "below", &plot.x);
    svg.finish()
}

/// Draws items without axes in one picture, such as a bar or a sparkline. Without words it is hidden from screen readers, for pictures
/// whose content is in the text beside them.
pub fn picture(drawn: &[Item], class: &str, words: &str) -> String {
    let mut svg = Writer::default();
    let picture = svg.element(Tag::Svg).set("class", class);
    if words.is_empty() {
        picture.set("aria-hidden", "true").open();
    } else {
        picture.set("role", "img").set("aria-label", words).open();
    }
    items(&mut svg, drawn);
    svg.finish()
}

/// Draws labels in a column at the left side of a picture.
pub fn rows(class: &str, ticks: &[Tick]) -> String {
    let mut svg = Writer::default();
    side(&mut svg, class, ticks);
    svg.finish()
}

/// Draws labels in a row above bars or below a plot. If they would touch, every second one is shown.
pub fn axis(class: &str, ticks: &[Tick]) -> String {
    let mut svg = Writer::default();
    row(&mut svg, class, &ticks.iter().map(|tick| (Anchor::Middle, tick)).collect::<Vec<_>>());
    svg.finish()
}

/// Draws the same row for a picture that has no room at its sides: labels at its ends are inside.
pub fn axis_within(class: &str, ticks: &[Tick]) -> String {
    let anchor = |tick: &Tick| match tick.at {
        left if left < END => Anchor::Start,
        right if right > 1.0 - END => Anchor::End,
        _ => Anchor::Middle,
    };
    let mut svg = Writer::default();
    row(&mut svg, class, &ticks.iter().map(|tick| (anchor(tick), tick)).collect::<Vec<_>>());
    svg.finish()
}

/// Draws a legend.
pub fn legend(keys: &[Key], class: &str) -> String {
    let mut svg = Writer::default();
    svg.element(Tag::Ul).set("class", class).open();
    for key in keys {
        svg.element(Tag::Li).set("class", "extra").open();
        let wide = if matches!(key.swatch, Swatch::Line(_)) { 18.0 } else { 10.0 };
        svg.element(Tag::Svg).set("width", wide).set("height", 10.0).set("aria-hidden", "true").open();
        let middle = At::new(0.5, 0.5);
        let sample = match &key.swatch {
            Swatch::Area(style) => Item::rect(At::new(0.0, 0.0), At::new(1.0, 1.0), style.clone()),
            Swatch::Line(style) => Item::line(At::new(0.0, 0.5), At::new(1.0, 0.5), style.clone()),
            Swatch::Mark(mark, style) | Swatch::Curve(_, mark, style) => {
                Item::mark(middle, *mark, 3.0, style.clone())
            }
        };
        items(&mut svg, &[sample]);
        svg.close();
        svg.words(&key.text);
        svg.close();
    }
    svg.finish()
}

/// Writes the title of an axis.
fn named(svg: &mut Writer, class: &str, axis: &Axis) {
    let title = axis.page_title();
    if !title.is_empty() {
        hidden(svg, Tag::Span, class).words(&title);
    }
}

/// Writes labels at the left side of a picture.
fn side(svg: &mut Writer, class: &str, ticks: &[Tick]) {
    hidden(svg, Tag::Svg, class).open();
    for tick in ticks {
        let row = svg.element(Tag::Text).set("x", Share(1.0)).set("y", Share(1.0 - tick.at));
        row.set("dy", Em(0.36)).set("text-anchor", "end").words(&tick.text);
    }
    svg.close();
}

fn hidden<'a>(svg: &'a mut Writer, tag: Tag, class: &str) -> crate::svg::Attributes<'a> {
    svg.element(tag).set("class", class).set("aria-hidden", "true")
}

fn line(svg: &mut Writer, class: &str, x: [f64; 2], y: [f64; 2]) {
    let line = svg.element(Tag::Line).set("class", class).set("x1", Share(x[0])).set("x2", Share(x[1]));
    line.set("y1", Share(y[0])).set("y2", Share(y[1])).leaf();
}

/// Writes labels, each with the width from which on it is shown.
fn row(svg: &mut Writer, class: &str, labels: &[(Anchor, &Tick)]) {
    let sides = |(anchor, tick): &(Anchor, &Tick)| match anchor {
        Anchor::Start => [0.0, rem(&tick.text)],
        Anchor::Middle => [rem(&tick.text) / 2.0; 2],
        Anchor::End => [rem(&tick.text), 0.0],
    };
    hidden(svg, Tag::Svg, &format!("axisrow {class}")).open();
    for (index, this) in labels.iter().enumerate() {
        // A label is hidden together with all others whose index is divisible by the same power of two.
        let stride = if index == 0 { labels.len() } else { 1 << index.trailing_zeros() };
        let before = index.checked_sub(stride).and_then(|other| labels.get(other));
        let after = labels.get(index + stride);
        let apart = [
            before.map(|other| (this.1.at - other.1.at, sides(this)[0] + sides(other)[1])),
            after.map(|other| (other.1.at - this.1.at, sides(this)[1] + sides(other)[0])),
        ];
        let needs = apart.into_iter().flatten().map(|(share, taken)| taken / share).fold(0.0, f64::max);
        let Some(step) = width_step(needs) else { continue };
        let (anchor, tick) = this;
        let text = svg.element(Tag::Text).set("class", format!("fits w{step}")).set("x", Share(tick.at));
        text.set("y", "70%").set("text-anchor", anchor.name()).words(&tick.text);
    }
    svg.close();
}

#[cfg(test)]
mod tests;
