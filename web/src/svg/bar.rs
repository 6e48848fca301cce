//! Bar of stages on a scale in ms.

use askama::Template;
use peernet_statistics::number::{figure, fixed};

use super::fit::Fitted;
use super::{Percent, Scale};
use crate::look;

/// Width below which a segment is drawn without a dividing line, which would hide it.
const CUT_FITS: f64 = 0.6;
/// Width below which an error bar is left out: it would look like the line between two segments.
const BOUND_SEEN: f64 = 0.4;

/// One stage of a bar.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Part {
    /// The stage's name.
    pub name: String,
    /// Length, seconds.
    pub seconds: f64,
    /// Half width of the bound of its length, seconds; for one-way delays.
    pub bound: Option<f64>,
}

/// A stack of stages with the total's quantiles as whiskers.
#[derive(Clone, Debug, PartialEq, Template)]
#[template(path = "svg/bar.html")]
pub(crate) struct Bar {
    class: &'static str,
    label: String,
    grid: Vec<Percent>,
    segments: Vec<Segment>,
    whiskers: Vec<Whisker>,
    /// Clock bounds of the ends of one-way delays: from and to.
    bounds: Vec<(Percent, Percent)>,
    /// An error bar about the end of the whole: from and to.
    spread: Option<(Percent, Percent)>,
}

impl askama::filters::HtmlSafe for Bar {}

#[derive(Clone, Debug, PartialEq)]
struct Segment {
    look: &'static str,
    pale: bool,
    cut: bool,
    x: Percent,
    width: Percent,
    end: Percent,
    middle: Percent,
    name: Option<Fitted>,
    value: Option<Fitted>,
}

impl Segment {
    /// Returns the value and the smallest width of the bar that shows it.
    fn written(&self) -> Option<(&str, u16)> {
        self.value.as_ref()?.shown()
    }

    /// Returns the name, which is drawn before the value, and the smallest width of the bar that shows it.
    fn named(&self) -> Option<(&str, u16)> {
        self.name.as_ref()?.shown()
    }
}

#[derive(Clone, Debug, PartialEq)]
struct Whisker {
    far: bool,
    from: Percent,
    to: Percent,
    /// `true` if the quantile lies beyond the axis.
    beyond: bool,
}

/// Returns a value inside a segment, where there is room for few digits.
fn short(milliseconds: f64) -> String {
    if (1.0..9.95).contains(&milliseconds) { fixed(milliseconds, 1) } else { figure(milliseconds) }
}

impl Bar {
    /// Draws a bar of `parts` in their order on a scale in ms. `label` describes the bar in words; it is empty where the figures next to
    /// the bar already do.
    pub(crate) fn new(class: &'static str, label: String, parts: &[Part], scale: &Scale) -> Self {
        let mut at = 0.0;
        let mut segments = Vec::with_capacity(parts.len());
        let mut bounds = Vec::new();
        for part in parts.iter().filter(|part| part.seconds > 0.0) {
            let milliseconds = part.seconds * 1e3;
            let (x, end) = (scale.at(at), scale.at(at + milliseconds));
            // The sum of both directions is exact: the uncertainty is where the other host's part begins and ends.
            let inner = if part.name == "download" { at } else { at + milliseconds };
            if let Some(bound) = part.bound.map(|bound| bound.min(part.seconds) * 1e3) {
                let (from, to) = (scale.at(inner - bound), scale.at(inner + bound));
                if to.0 - from.0 >= BOUND_SEEN {
                    bounds.push((from, to));
                }
            }
            let width = Percent(end.0 - x.0);
            let value = short(milliseconds);
            let name = format!("{} ", look::short(&part.name));
            at += milliseconds;
            segments.push(Segment {
                look: look::class(&part.name),
                pale: look::is_pale(&part.name),
                cut: !segments.is_empty() && width.0 > CUT_FITS,
                x,
                width,
                end,
                middle: Percent(x.0 + width.0 / 2.0),
                name: Some(Fitted::within(width.0, name, &value)),
                value: Some(Fitted::within(width.0, value, "")),
            });
        }
        Self { class, label, grid: scale.grid(), segments, whiskers: Vec::new(), bounds, spread: None }
    }

    /// Adds an error bar of `spread` seconds to both sides of the bar's end, which lies at `mean` seconds. Values that it would cross are
    /// not written.
    pub(crate) fn spread(mut self, mean: f64, spread: f64, scale: &Scale) -> Self {
        let (from, to) = (scale.at((mean - spread) * 1e3), scale.at((mean + spread) * 1e3));
        for segment in &mut self.segments {
            for text in segment.name.iter_mut().chain(&mut segment.value) {
                text.clear_of(segment.middle.0, from.0, to.0);
            }
        }
        self.spread = Some((from, to));
        self
    }

    /// Omits values and clock bounds in the segments, for bars that are too low for text.
    pub(crate) fn silent(mut self) -> Self {
        for segment in &mut self.segments {
            (segment.name, segment.value) = (None, None);
        }
        self.bounds.clear();
        self
    }

    /// Omits the grid lines, for a bar without an axis.
    pub(crate) fn without_grid(mut self) -> Self {
        self.grid.clear();
        self
    }

    /// Adds whiskers from the bar's end: solid to the 95th percentile, dotted from there to the 99th.
    pub(crate) fn whiskers(mut self, p95: Option<f64>, p99: Option<f64>, scale: &Scale) -> Self {
        let mut from = self.segments.last().map_or(Percent(0.0), |segment| segment.end);
        for (far, quantile) in [(false, p95), (true, p99)] {
            let Some(milliseconds) = quantile.map(|seconds| seconds * 1e3) else { continue };
            let to = scale.at(milliseconds);
            if to > from {
                self.whiskers.push(Whisker { far, from, to, beyond: !scale.holds(milliseconds) });
                from = to;
            }
        }
        self
    }
}

/// A share of the whole as a short bar with its number.
#[derive(Clone, Debug, PartialEq, Template)]
#[template(path = "svg/share.html")]
pub(crate) struct ShareBar {
    look: &'static str,
    width: Percent,
    text_at: Percent,
    text: String,
    total: bool,
}

impl askama::filters::HtmlSafe for ShareBar {}

impl ShareBar {
    /// Returns the bar of a share between 0 and 1; a full bar leaves room for its number.
    pub(crate) fn new(name: &str, share: f64) -> Self {
        const FULL: f64 = 72.0;
        let width = share.clamp(0.0, 1.0) * FULL;
        Self {
            look: look::class(name),
            width: Percent(width),
            text_at: Percent(width + 2.0),
            text: peernet_statistics::number::share(share),
            total: name == "total",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(name: &str, milliseconds: f64) -> Part {
        Part { name: name.to_owned(), seconds: milliseconds / 1e3, bound: None }
    }

    #[test]
    fn a_segment_holds_its_value_and_its_name_where_the_bar_is_wide_enough_for_them() {
        let scale = Scale::fit(30.0, 6);
        let parts = [part("sensing", 2.0), part("preprocessing", 2.6), part("inference", 13.1)];
        let bar = Bar::new("", "in words".into(), &parts, &scale).to_string();
        assert!(bar.contains("<tspan class=\"fits w15\">inference </tspan>13.1<"), "{bar}");
        assert!(bar.contains("<tspan class=\"fits w90\">preprocessing </tspan>2.6<"), "{bar}");
        assert!(bar.contains("<text class=\"o-preprocessing fits w18\""), "{bar}");
        assert!(bar.contains("edge f-preprocessing"), "pale fills carry an edge: {bar}");
        assert!(bar.contains("aria-label=\"in words\""), "{bar}");
    }

    #[test]
    fn whiskers_begin_where_the_bar_ends_and_never_run_backwards() {
        let scale = Scale::fit(30.0, 6);
        let parts = [part("upload", 20.0)];
        let bar = Bar::new("", String::new(), &parts, &scale);
        let both = bar.clone().whiskers(Some(0.024), Some(0.027), &scale);
        assert_eq!(both.whiskers.len(), 2);
        assert_eq!(both.whiskers[0].from, both.segments[0].end);
        assert_eq!(both.whiskers[1].from, both.whiskers[0].to);
        assert!(bar.clone().whiskers(Some(0.019), None, &scale).whiskers.is_empty());
        let beyond = bar.whiskers(Some(0.9), None, &scale);
        assert_eq!((beyond.whiskers[0].to, beyond.whiskers[0].beyond), (Percent(100.0), true));
    }

    #[test]
    fn error_bars_stand_where_a_direction_meets_the_other_host() {
        let scale = Scale::fit(30.0, 6);
        let bounded =
            |name: &str, milliseconds, bound| Part { bound: Some(bound / 1e3), ..part(name, milliseconds) };
        let parts = [bounded("upload", 15.0, 3.0), part("inference", 6.0), bounded("download", 3.0, 6.0)];
        let bar = Bar::new("", String::new(), &parts, &scale);
        let close = |a: Percent, b: f64| (a.0 - b).abs() < 1e-9;
        assert!(close(bar.bounds[0].0, 40.0) && close(bar.bounds[0].1, 60.0), "{:?}", bar.bounds);
        // A bound wider than the delay ends where the delay would be nothing.
        assert!(close(bar.bounds[1].0, 60.0) && close(bar.bounds[1].1, 80.0), "{:?}", bar.bounds);
        let fine = [bounded("upload", 15.0, 0.01)];
        assert!(Bar::new("", String::new(), &fine, &scale).bounds.is_empty());
    }

    #[test]
    fn an_error_bar_crosses_no_figure() {
        let scale = Scale::fit(30.0, 6);
        let parts = [part("sensing", 10.0), part("inference", 10.0)];
        let bar = Bar::new("", String::new(), &parts, &scale);
        let values = |bar: Bar| bar.segments.iter().map(|one| Some(one.written()?.1)).collect::<Vec<_>>();
        assert_eq!(values(bar.clone()), [Some(8), Some(8)]);
        assert_eq!(values(bar.clone().spread(0.020, 0.001, &scale)), [Some(8), Some(8)]);
        assert_eq!(values(bar.clone().spread(0.020, 0.004, &scale)), [Some(8), Some(30)]);
        let wide = bar.spread(0.020, 0.025, &scale);
        assert_eq!(wide.spread, Some((Percent(0.0), Percent(100.0))));
        assert_eq!(values(wide), [None, None]);
    }

    #[test]
    fn names_are_escaped() {
        let scale = Scale::fit(10.0, 5);
        let bar = Bar::new("", "<b>".into(), &[part("<script>", 9.0)], &scale).to_string();
        assert!(!bar.contains("<script>") && !bar.contains("<b>"), "{bar}");
    }
}
