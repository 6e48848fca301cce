//! SVG for web pages. The SVG grows with its panel. Classes of the style sheet determine its colours.
//!
//! Plots are laid out in a grid of the style sheet (`.plot-with-axes`, `.joint`, …) with the classes `above`, `over`,
//! `yaxis`, `plot`, `beside`, `xaxis` and `below`. The server does not know the width of a page, so text that might not
//! fit has a class for the minimum width of its picture (`.fits.w8`, …). The style sheet hides the text in narrower
//! pictures, because a clipped number would be a wrong number.

mod draw;

use draw::{draw_items, draw_label};

use crate::plot::{Anchor, At, Axis, Item, Key, Label, Plot, Swatch};
use crate::scale::Tick;
use crate::svg::{Em, Share, Tag, Writer};
use crate::text::{width_rem, width_step};

/// Distance from the top of a plot up to the baseline of a remark above the plot, as a multiple of the type size.
const REMARK_RISE: f64 = 0.4;
/// Distance from the top of a plot down to the baseline of a remark inside the plot, as a multiple of the type size.
/// The remark is inside if labels are above the plot.
const REMARK_DROP: f64 = 0.9;
/// Maximum distance of a tick from an end of the axis, as a share of the axis, at which [`axis_within`] begins or ends
/// the tick's label at the tick. The label then does not extend beyond the axis.
const MAX_END_DISTANCE: f64 = 0.04;

/// Draws a plot with its axes. `class` is the class of the plot's grid in the style sheet. `description` describes the
/// plot for screen readers.
pub fn plot(plot: &Plot, class: &str, description: &str) -> String {
    let mut svg = Writer::default();
    svg.element(Tag::Div).set("class", class).set("role", "img").set("aria-label", description).open();
    write_axis_title(&mut svg, "above", &plot.y);
    if let Some(strip) = &plot.top_strip {
        aria_hidden_element(&mut svg, Tag::Svg, "over").open();
        draw_items(&mut svg, &strip.items);
        svg.close();
    }
    // The server does not know the height of the plot, so only the axes limit the number of their marks.
    let (y_ticks, x_ticks) = (plot.y.ticks(usize::MAX), plot.x.ticks(usize::MAX));
    write_y_labels(&mut svg, "yaxis", &y_ticks);
    aria_hidden_element(&mut svg, Tag::Svg, "plot").open();
    for tick in y_ticks.iter().filter(|_| plot.y.has_grid) {
        line(&mut svg, "gridl", [0.0, 1.0], [1.0 - tick.at; 2]);
    }
    for tick in x_ticks.iter().filter(|_| plot.x.has_grid) {
        line(&mut svg, "gridl", [tick.at; 2], [0.0, 1.0]);
    }
    draw_items(&mut svg, &plot.items);
    if let Some(remark) = &plot.remark {
        let label = Label::new(At::new(1.0, 0.0), remark.clone(), crate::look::TextStyle::BEYOND);
        let baseline = if plot.lines_above > 0 { REMARK_DROP } else { -REMARK_RISE };
        draw_label(&mut svg, &label.anchored(Anchor::End).shifted(0.0, baseline));
    }
    svg.close();
    if let Some(strip) = &plot.right_strip {
        aria_hidden_element(&mut svg, Tag::Svg, "beside").open();
        draw_items(&mut svg, &strip.items);
        svg.close();
    }
    let x_labels: Vec<_> = x_ticks.iter().map(|tick| (Anchor::Middle, tick)).collect();
    write_x_labels(&mut svg, "xaxis", &x_labels);
    write_axis_title(&mut svg, "below", &plot.x);
    svg.finish()
}

/// Draws items without axes in one picture, such as a bar or a sparkline. `description` describes the picture for
/// screen readers. If `description` is empty, the picture is hidden from screen readers, because the text beside the
/// picture has the same content.
pub fn picture(items: &[Item], class: &str, description: &str) -> String {
    let mut svg = Writer::default();
    let picture = svg.element(Tag::Svg).set("class", class);
    if description.is_empty() {
        picture.set("aria-hidden", "true").open();
    } else {
        picture.set("role", "img").set("aria-label", description).open();
    }
    draw_items(&mut svg, items);
    svg.finish()
}

/// Draws labels in a column at the left side of a picture.
pub fn y_labels(class: &str, ticks: &[Tick]) -> String {
    let mut svg = Writer::default();
    write_y_labels(&mut svg, class, ticks);
    svg.finish()
}

/// Draws labels in a row above bars or below a plot. If neighbouring labels would touch, every second label is hidden.
/// If the remaining labels would touch, only every fourth label is shown, and so on.
pub fn axis(class: &str, ticks: &[Tick]) -> String {
    let mut svg = Writer::default();
    write_x_labels(&mut svg, class, &ticks.iter().map(|tick| (Anchor::Middle, tick)).collect::<Vec<_>>());
    svg.finish()
}

/// Draws the same row as [`axis`], for a picture that has no room at its sides. Labels at the ends of the row stay
/// inside the picture.
pub fn axis_within(class: &str, ticks: &[Tick]) -> String {
    let anchor = |tick: &Tick| match tick.at {
        left if left < MAX_END_DISTANCE => Anchor::Start,
        right if right > 1.0 - MAX_END_DISTANCE => Anchor::End,
        _ => Anchor::Middle,
    };
    let mut svg = Writer::default();
    write_x_labels(&mut svg, class, &ticks.iter().map(|tick| (anchor(tick), tick)).collect::<Vec<_>>());
    svg.finish()
}

/// Draws a legend. The sample of a curve is its mark, without its line.
pub fn legend(keys: &[Key], class: &str) -> String {
    let mut svg = Writer::default();
    svg.element(Tag::Ul).set("class", class).open();
    for key in keys {
        // `extra` is the style sheet's class for entries that are not buttons.
        svg.element(Tag::Li).set("class", "extra").open();
        let sample_width = if matches!(key.swatch, Swatch::Line(_)) { 18.0 } else { 10.0 };
        svg.element(Tag::Svg)
            .set("width", sample_width)
            .set("height", 10.0)
            .set("aria-hidden", "true")
            .open();
        let middle = At::new(0.5, 0.5);
        let sample = match &key.swatch {
            Swatch::Area(style) => Item::rect(At::new(0.0, 0.0), At::new(1.0, 1.0), style.clone()),
            Swatch::Line(style) => Item::line(At::new(0.0, 0.5), At::new(1.0, 0.5), style.clone()),
            Swatch::Mark(mark, style) | Swatch::Curve(_, mark, style) => {
                Item::mark(middle, *mark, 3.0, style.clone())
            }
        };
        draw_items(&mut svg, &[sample]);
        svg.close();
        svg.text(&key.text);
        svg.close();
    }
    svg.finish()
}

/// Writes the title of an axis.
fn write_axis_title(svg: &mut Writer, class: &str, axis: &Axis) {
    let title = axis.page_title();
    if !title.is_empty() {
        aria_hidden_element(svg, Tag::Span, class).text(&title);
    }
}

/// Writes labels in a column at the left side of a picture.
fn write_y_labels(svg: &mut Writer, class: &str, ticks: &[Tick]) {
    aria_hidden_element(svg, Tag::Svg, class).open();
    for tick in ticks {
        let text = svg.element(Tag::Text).set("x", Share(1.0)).set("y", Share(1.0 - tick.at));
        text.set("dy", Em(0.36)).set("text-anchor", "end").text(&tick.text);
    }
    svg.close();
}

/// Begins an element that screen readers skip, because the `aria-label` of the whole plot describes its content.
fn aria_hidden_element<'a>(svg: &'a mut Writer, tag: Tag, class: &str) -> crate::svg::Attributes<'a> {
    svg.element(tag).set("class", class).set("aria-hidden", "true")
}

fn line(svg: &mut Writer, class: &str, x: [f64; 2], y: [f64; 2]) {
    let line = svg.element(Tag::Line).set("class", class).set("x1", Share(x[0])).set("x2", Share(x[1]));
    line.set("y1", Share(y[0])).set("y2", Share(y[1])).leaf();
}

/// Writes labels in a row. Each label has the class of the minimum width of a picture that shows the label.
fn write_x_labels(svg: &mut Writer, class: &str, labels: &[(Anchor, &Tick)]) {
    // Width of a label to the left and to the right of its tick.
    let side_widths = |(anchor, tick): &(Anchor, &Tick)| match anchor {
        Anchor::Start => [0.0, width_rem(&tick.text)],
        Anchor::Middle => [width_rem(&tick.text) / 2.0; 2],
        Anchor::End => [width_rem(&tick.text), 0.0],
    };
    aria_hidden_element(svg, Tag::Svg, &format!("axisrow {class}")).open();
    for (index, label) in labels.iter().enumerate() {
        // As the picture gets narrower, labels are hidden in steps: first the labels whose index is odd, then the
        // labels whose index is an odd multiple of 2, then an odd multiple of 4, and so on. The first label is always
        // shown. In the step in which a label is hidden, the distance of its visible neighbours is `stride` indexes.
        let stride = if index == 0 { labels.len() } else { 1 << index.trailing_zeros() };
        let previous = index.checked_sub(stride).and_then(|other| labels.get(other));
        let next = labels.get(index + stride);
        // For each neighbour: its distance as a share of the picture, and the width that this label and the neighbour
        // need between their ticks.
        let distances_and_widths = [
            previous.map(|other| (label.1.at - other.1.at, side_widths(label)[0] + side_widths(other)[1])),
            next.map(|other| (other.1.at - label.1.at, side_widths(label)[1] + side_widths(other)[0])),
        ];
        let min_width = distances_and_widths
            .into_iter()
            .flatten()
            .map(|(share, width)| width / share)
            .fold(0.0, f64::max);
        let Some(step) = width_step(min_width) else { continue };
        let (anchor, tick) = label;
        let text = svg.element(Tag::Text).set("class", format!("fits w{step}")).set("x", Share(tick.at));
        text.set("y", "70%").set("text-anchor", anchor.name()).text(&tick.text);
    }
    svg.close();
}

#[cfg(test)]
mod tests;
