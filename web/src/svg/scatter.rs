//! Points with error bars and lines through them.

use askama::Template;

use super::{Axis, Horizontal, Percent, Ruler, pen};

/// Points of a line that is drawn: on a logarithmic axis a straight line is a curve.
const STEPS: u32 = 64;
/// Size of a letter on a narrow plot, percent of its width and height: less than the distance of a name above or below its point.
const LETTER: (f64, f64) = (2.4, 6.0);
/// Distance of a name from the middle of its point.
const AWAY: (f64, f64) = (2.2, 6.5);
/// Largest number of names in one label; the table has all.
const MOST_NAMES: usize = 2;
/// Shift of a name to the right of its point, in ems.
const RIGHT: (&str, &str) = (".7em", ".36em");

/// Points of several series.
#[derive(Clone, Debug, PartialEq, Template)]
#[template(path = "svg/scatter.html")]
pub(crate) struct Scatter {
    label: String,
    x_unit: &'static str,
    y_unit: &'static str,
    rows: Vec<(Percent, String)>,
    columns: Axis,
    lines: Vec<(&'static str, String)>,
    dots: Vec<Dot>,
    names: Vec<Label>,
    key: Vec<(&'static str, String)>,
}

impl askama::filters::HtmlSafe for Scatter {}

/// Points that share a look.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ScatterSeries {
    /// The class of their colour.
    pub look: &'static str,
    /// Name of the series in the key.
    pub name: String,
    pub points: Vec<ScatterPoint>,
    /// Straight lines through them.
    pub lines: Vec<ScatterLine>,
}

/// One point.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ScatterPoint {
    pub x: f64,
    pub y: f64,
    /// Lower and upper end of its error bar.
    pub ends: Option<(f64, f64)>,
    /// Label beside the point; none if empty.
    pub name: String,
}

impl ScatterPoint {
    /// Returns the upper end of the point and its error bar.
    pub(crate) fn top(&self) -> f64 {
        self.ends.map_or(self.y, |(_, high)| high)
    }
}

/// A straight line between two values of x.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ScatterLine {
    pub intercept: f64,
    pub slope: f64,
    pub from: f64,
    pub to: f64,
}

#[derive(Clone, Debug, PartialEq)]
struct Dot {
    look: &'static str,
    x: Percent,
    y: Percent,
    whisker: Option<(Percent, Percent)>,
}

impl Dot {
    /// Returns the points along its error bar.
    fn whole_whisker(&self) -> impl Iterator<Item = (f64, f64)> {
        let ends = self.whisker.into_iter().map(|(low, high)| (low.0, high.0));
        ends.flat_map(move |(low, high)| {
            (0..=STEPS).map(move |step| (self.x.0, low + (high - low) * f64::from(step) / f64::from(STEPS)))
        })
    }
}

/// A name next to its point.
#[derive(Clone, Debug, PartialEq)]
struct Label {
    /// Position of its point.
    dot: (Percent, Percent),
    /// Shift from there, in ems: a wide plot needs no more distance than a narrow one.
    shift: (&'static str, &'static str),
    /// Position on a narrow plot, the worst case: a place that is free there is free at every width.
    x: Percent,
    y: Percent,
    anchor: &'static str,
    /// The places of its points in their series, and their names.
    points: Vec<(usize, String)>,
    text: String,
}

impl Label {
    /// Adds the name of another point.
    fn join(&mut self, at: usize, name: &str) {
        self.points.push((at, name.to_owned()));
        self.text = listed(&self.points);
    }

    fn overlaps(&self, other: (f64, f64, f64)) -> bool {
        let (x, y, letters) = other;
        let width = LETTER.0 * self.text.chars().count() as f64;
        let left = match self.anchor {
            "start" => self.x.0,
            "end" => self.x.0 - width,
            _ => self.x.0 - width / 2.0,
        };
        let half = LETTER.0 * letters / 2.0;
        left < x + half && x - half < left + width && (self.y.0 - y).abs() < LETTER.1
    }

    /// Returns whether something that is drawn there runs through it.
    fn is_crossed(&self, (x, y): (f64, f64)) -> bool {
        let (middle, height, letters) = self.place();
        (middle - x).abs() < LETTER.0 * letters / 2.0 && (height - y).abs() < LETTER.1 / 2.0
    }

    /// Returns its middle and its length in letters.
    fn place(&self) -> (f64, f64, f64) {
        let letters = self.text.chars().count() as f64;
        let half = LETTER.0 * letters / 2.0;
        let middle = match self.anchor {
            "start" => self.x.0 + half,
            "end" => self.x.0 - half,
            _ => self.x.0,
        };
        (middle, self.y.0, letters)
    }
}

impl Scatter {
    /// Draws the series on these axes; `label` describes them in words.
    pub(crate) fn new(
        label: String,
        (x_unit, across): (&'static str, &Horizontal),
        (y_unit, up): (&'static str, &Ruler),
        series: &[ScatterSeries],
    ) -> Self {
        let height = |value: f64| Percent(up.below(value) * 100.0);
        let dots = series.iter().flat_map(|one| one.points.iter().map(|point| (one.look, point)));
        let dots = dots.map(|(look, point)| Dot {
            look,
            x: across.at(point.x),
            y: height(point.y),
            whisker: point.ends.map(|(low, high)| (height(low), height(high))),
        });
        let dots: Vec<Dot> = dots.collect();
        let points = series.iter().flat_map(|one| one.points.iter().enumerate());
        let course = |line: &ScatterLine| -> Vec<(f64, f64)> {
            let steps = (0..=STEPS).map(|step| f64::from(step) / f64::from(STEPS));
            let points = steps.map(|step| {
                let x = across.between(line.from, line.to, step);
                (across.at(x).0 / 100.0, up.below(line.intercept + line.slope * x))
            });
            points.collect()
        };
        let lines = series.iter().flat_map(|one| one.lines.iter().map(move |it| (one.look, it)));
        let lines: Vec<_> = lines.map(|(look, it)| (look, course(it))).collect();
        let drawn = lines.iter().flat_map(|(_, course)| course).map(|(x, y)| (x * 100.0, y * 100.0));
        let drawn: Vec<(f64, f64)> = drawn.chain(dots.iter().flat_map(Dot::whole_whisker)).collect();
        let names = beside(&dots, &drawn, points.map(|(at, point)| (at, point.name.as_str())));
        Self {
            label,
            x_unit,
            y_unit,
            rows: up.ticks(),
            columns: Axis::below(across.ticks()),
            lines: lines
                .into_iter()
                .map(|(look, course)| (look, pen::line(course.into_iter().map(Some))))
                .collect(),
            dots,
            names,
            key: series.iter().map(|one| (one.look, one.name.clone())).collect(),
        }
    }
}

/// Returns a name at each point where there is room: right, left, above, below or askew, where nothing that is drawn runs through
/// it if there is such a place; where there is no room, it joins the nearest name.
fn beside<'a>(
    dots: &[Dot],
    drawn: &[(f64, f64)],
    texts: impl Iterator<Item = (usize, &'a str)>,
) -> Vec<Label> {
    let mut names: Vec<Label> = Vec::new();
    for (dot, (place, text)) in dots.iter().zip(texts).filter(|(_, (_, text))| !text.is_empty()) {
        let at = |dx: f64, dy: f64, anchor, shift| Label {
            dot: (dot.x, dot.y),
            shift,
            x: Percent(dot.x.0 + dx),
            y: Percent(dot.y.0 + dy),
            anchor,
            points: vec![(place, text.to_owned())],
            text: text.to_owned(),
        };
        let tries = [
            at(AWAY.0, 0.0, "start", RIGHT),
            at(-AWAY.0, 0.0, "end", ("-.7em", ".36em")),
            at(0.0, -AWAY.1, "middle", ("0", "-.8em")),
            at(0.0, AWAY.1, "middle", ("0", "1.5em")),
            at(AWAY.0, -AWAY.1, "start", (".6em", "-.8em")),
            at(AWAY.0, AWAY.1, "start", (".6em", "1.5em")),
            at(-AWAY.0, -AWAY.1, "end", ("-.6em", "-.8em")),
            at(-AWAY.0, AWAY.1, "end", ("-.6em", "1.5em")),
        ];
        let free = |label: &Label| {
            let on_dots = dots.iter().any(|other| label.overlaps((other.x.0, other.y.0, 1.0)));
            !on_dots && !names.iter().any(|other| label.overlaps(other.place()))
        };
        let is_clear = |label: &&Label| free(label) && !drawn.iter().any(|at| label.is_crossed(*at));
        if let Some(label) = tries.iter().find(is_clear).or_else(|| tries.iter().find(|label| free(label))) {
            let label = label.clone();
            names.push(label);
            continue;
        }
        let far = |label: &Label| (label.x.0 - dot.x.0).hypot(label.y.0 - dot.y.0);
        match names.iter_mut().min_by(|a, b| far(a).total_cmp(&far(b))) {
            Some(nearest) => nearest.join(place, text),
            None => names.push(at(AWAY.0, 0.0, "start", RIGHT)),
        }
    }
    names
}

/// Returns `local, cloud and 4 more`: in the order of their points, each name once.
fn listed(points: &[(usize, String)]) -> String {
    let mut sorted = points.to_vec();
    sorted.sort();
    let mut names: Vec<&str> = Vec::new();
    for (_, name) in &sorted {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    let shown = names[..names.len().min(MOST_NAMES)].join(", ");
    match names.len().saturating_sub(MOST_NAMES) {
        0 => shown,
        more => format!("{shown} and {more} more"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(points: &[(f64, f64)], lines: Vec<ScatterLine>) -> ScatterSeries {
        let point = |(at, (x, y)): (usize, &(f64, f64))| ScatterPoint {
            x: *x,
            y: *y,
            ends: Some((*y - 1.0, *y + 1.0)),
            name: char::from(b'A' + at as u8).to_string(),
        };
        let points = points.iter().enumerate().map(point).collect();
        ScatterSeries { look: "total", name: "total".to_owned(), points, lines }
    }

    fn plot(points: &[(f64, f64)], lines: Vec<ScatterLine>) -> Scatter {
        let across = Horizontal::of(points.iter().map(|point| point.0));
        let up = Ruler::from_zero(10.0, 5);
        Scatter::new("what".to_owned(), ("kB", &across), ("ms", &up), &[series(points, lines)])
    }

    #[test]
    fn points_lie_where_their_values_are() {
        let plot = plot(&[(0.0, 0.0), (100.0, 9.0)], Vec::new());
        assert_eq!((plot.dots[0].x, plot.dots[0].y), (Percent(0.0), Percent(100.0)));
        assert_eq!((plot.dots[1].x < Percent(100.0), plot.dots[1].y), (true, Percent(10.0)));
        let html = plot.to_string();
        assert!(html.contains("role=\"img\"") && html.contains("cx=\"0.000%\""), "{html}");
    }

    #[test]
    fn sizes_of_several_powers_of_ten_are_equally_far_apart() {
        let line = ScatterLine { intercept: 1.0, slope: 0.001, from: 1.0, to: 1_000.0 };
        let plot = plot(&[(1.0, 1.0), (31.622_776, 2.0), (1_000.0, 3.0)], vec![line]);
        let x = |at: usize| plot.dots[at].x.0;
        assert!((x(1) - x(0) - (x(2) - x(1))).abs() < 1e-3, "{:?}", plot.dots);
        assert_eq!(plot.columns.labels_at(30), ["1", "10", "100", "1,000"]);
        assert!(plot.lines[0].1.matches('L').count() == STEPS as usize, "{:?}", plot.lines);
        // The class hides its elements until they fit.
        assert!(!plot.to_string().contains("<svg class=\"fits"), "{plot}");
    }

    #[test]
    fn names_do_not_lie_on_each_other() {
        let near: Vec<(f64, f64)> =
            (0..12).map(|at| (100.0 + f64::from(at) * 0.2, 5.0 + f64::from(at) * 0.05)).collect();
        let plot = plot(&near, Vec::new());
        let shown: usize = plot.names.iter().map(|name| name.points.len()).sum();
        assert_eq!(shown, 12, "{:?}", plot.names);
        for (at, name) in plot.names.iter().enumerate() {
            assert!(plot.names[..at].iter().all(|other| !name.overlaps(other.place())), "{:?}", plot.names);
        }
    }

    #[test]
    fn a_point_between_neighbours_at_its_height_has_its_own_name_above_or_below() {
        let heights = [(0.0, 5.0), (50.0, 5.0), (57.7, 5.0), (60.7, 5.0), (100.0, 5.0)];
        let plot = plot(&heights, Vec::new());
        let names: Vec<&str> = plot.names.iter().map(|name| name.text.as_str()).collect();
        assert_eq!(names, ["A", "B", "C", "D", "E"], "{:?}", plot.names);
    }

    #[test]
    fn no_line_runs_through_a_name_where_there_is_room_beside_it() {
        let level = |from, to| ScatterLine { intercept: 5.0, slope: 0.0, from, to };
        let plot = plot(&[(10.0, 5.0), (50.0, 5.0), (90.0, 5.0)], vec![level(10.0, 50.0), level(50.0, 90.0)]);
        assert_eq!(plot.names.len(), 3, "{:?}", plot.names);
        for name in &plot.names {
            let along = (0..=1_000).map(|at| (f64::from(at) / 10.0, plot.dots[1].y.0));
            let on_line = along.filter(|(x, _)| (plot.dots[0].x.0..plot.dots[2].x.0).contains(x));
            assert!(on_line.into_iter().all(|at| !name.is_crossed(at)), "{name:?}");
        }
    }

    #[test]
    fn many_names_at_one_place_are_a_few_words() {
        let of = |places: &[usize]| {
            let name = |at: &usize| (*at, char::from(b'A' + *at as u8).to_string());
            listed(&places.iter().map(name).collect::<Vec<_>>())
        };
        assert_eq!(of(&[4]), "E");
        assert_eq!(of(&[1, 0]), "A, B");
        assert_eq!(of(&[5, 0, 2, 3, 4]), "A, C and 3 more");
        assert_eq!(listed(&[(0, "lan".to_owned()), (1, "lan".to_owned())]), "lan");
    }
}
