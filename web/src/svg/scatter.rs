//! Points with error bars over two axes that begin at zero.

use askama::Template;

use super::{Percent, Ruler, Scale};

/// Points of several series.
#[derive(Clone, Debug, PartialEq, Template)]
#[template(path = "svg/scatter.html")]
pub(crate) struct Scatter {
    label: String,
    x_unit: &'static str,
    y_unit: &'static str,
    rows: Vec<(Percent, String)>,
    columns: Vec<(Percent, String)>,
    dots: Vec<Dot>,
    key: Vec<(&'static str, String)>,
}

impl askama::filters::HtmlSafe for Scatter {}

/// Points that share a look.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ScatterSeries {
    /// The class of their colour.
    pub look: &'static str,
    /// What they are, in the key.
    pub name: String,
    pub points: Vec<ScatterPoint>,
}

/// One point.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ScatterPoint {
    pub x: f64,
    pub y: f64,
    /// Half the length of its error bar.
    pub spread: Option<f64>,
    /// Stands beside it.
    pub name: String,
}

#[derive(Clone, Debug, PartialEq)]
struct Dot {
    look: &'static str,
    x: Percent,
    y: Percent,
    whisker: Option<(Percent, Percent)>,
    name: String,
}

impl Scatter {
    /// Draws the series; `label` says in words what they show.
    pub(crate) fn new(
        label: String,
        x_unit: &'static str,
        y_unit: &'static str,
        series: &[ScatterSeries],
    ) -> Self {
        let all = || series.iter().flat_map(|one| &one.points);
        // Room for the last name.
        let across = Scale::fit(all().map(|point| point.x).fold(0.0, f64::max) * 1.02, 6);
        let most = all().map(|point| point.y + point.spread.unwrap_or(0.0)).fold(0.0, f64::max);
        let up = Ruler::from_zero(most, 5);
        let height = |value: f64| Percent(up.below(value.max(0.0)) * 100.0);
        let dots = series.iter().flat_map(|one| one.points.iter().map(|point| (one.look, point)));
        let dots = dots.map(|(look, point)| Dot {
            look,
            x: across.at(point.x),
            y: height(point.y),
            whisker: point.spread.map(|spread| (height(point.y - spread), height(point.y + spread))),
            name: point.name.clone(),
        });
        Self {
            label,
            x_unit,
            y_unit,
            rows: up.ticks(),
            columns: across.grid().into_iter().zip(across.labels()).collect(),
            dots: dots.collect(),
            key: series.iter().map(|one| (one.look, one.name.clone())).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_lie_where_their_values_are() {
        let point = |x, y| ScatterPoint { x, y, spread: Some(1.0), name: "A".to_owned() };
        let series = ScatterSeries {
            look: "total",
            name: "total".to_owned(),
            points: vec![point(0.0, 0.0), point(100.0, 9.0)],
        };
        let plot = Scatter::new("what".to_owned(), "kB", "ms", &[series]);
        assert_eq!((plot.dots[0].x, plot.dots[0].y), (Percent(0.0), Percent(100.0)));
        assert_eq!((plot.dots[1].x < Percent(100.0), plot.dots[1].y), (true, Percent(10.0)));
        assert_eq!(plot.dots[0].whisker.expect("drawn").0, Percent(100.0), "nothing lasts less than nothing");
        let html = plot.to_string();
        assert!(html.contains("role=\"img\"") && html.contains("cx=\"0.000%\""), "{html}");
    }
}
