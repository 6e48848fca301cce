//! What the stages of several configurations add up to: a bar each, with how much their sum varies.

use peernet_statistics::number::fixed;
use plotters::element::PathElement;
use plotters::prelude::DrawingBackend;
use plotters::style::text_anchor::{HPos, VPos};
use plotters::style::{Color, WHITE};

use super::histogram::nothing;
use super::kit::{
    Axis, Drawn, Figure, Frame, Header, INK, Key, Paper, SIZE, SMALL, Swatch, TEXT, Unit, fill,
    shorten_apart, style, text, text_on_ground, width,
};
use super::stage::stage_fill;

/// Height of a lying bar with its room, pixels.
const ROW: i32 = 96;
/// The same where there are many: sixty are a page.
const CLOSE: i32 = 64;
/// From how many bars on they stand closer.
const MANY: usize = 16;
/// Most bars that stand upright: their labels stand below.
const MOST_UPRIGHT: usize = 6;
/// Height of the words above an upright bar, pixels.
const WORDS: i32 = SMALL + 20;
/// What of a part is seen however little it is, pixels.
const THIN: i32 = 4;
/// Width of the line between two parts, pixels.
const PARTING: u32 = 3;
/// Half the width of an error bar's cap.
const CAP: i32 = 12;

/// Bars of stages.
#[derive(Clone, Debug, PartialEq)]
pub struct Stacked {
    /// What is shown.
    pub title: String,
    /// What stands along the axis of values.
    pub unit: Unit,
    /// The stages from the first to the last; every bar has a value for each, 0 where it has no such stage.
    pub stages: Vec<String>,
    /// One for each configuration.
    pub bars: Vec<Bar>,
    /// How the parts are to be read.
    pub notes: Vec<String>,
}

/// A configuration's bar, SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Bar {
    /// What distinguishes it.
    pub label: String,
    /// The mean of each stage. Where clocks were not corrected it may be negative.
    pub means: Vec<f64>,
    /// Mean of the total, which the parts add up to as far as all of them are known.
    pub total: f64,
    /// Standard deviation of the total; `None` where it is not known.
    pub std: Option<f64>,
}

/// Where bars lie: along the axis of values and across it.
struct Places {
    values: Axis,
    upright: bool,
}

impl Places {
    /// The rectangle between two values and two places across, left upper corner first.
    fn area(&self, (from, to): (f64, f64), (near, far): (i32, i32)) -> [(i32, i32); 2] {
        let (from, to) = (self.values.at(from), self.values.at(to));
        let (low, high) = (from.min(to), from.max(to));
        if self.upright { [(near, low), (far, high)] } else { [(low, near), (high, far)] }
    }

    /// How far an area reaches along the axis of values, pixels.
    fn extent(&self, [low, high]: [(i32, i32); 2]) -> i32 {
        if self.upright { high.1 - low.1 } else { high.0 - low.0 }
    }

    /// The area, or one that can be seen if it cannot.
    fn at_least(&self, extent: i32, area: [(i32, i32); 2]) -> [(i32, i32); 2] {
        let [low, high] = area;
        let lack = (extent - self.extent(area)).max(0);
        if self.upright { [(low.0, low.1 - lack), high] } else { [low, (high.0 + lack, high.1)] }
    }

    fn point(&self, value: f64, across: i32) -> (i32, i32) {
        let at = self.values.at(value);
        if self.upright { (across, at) } else { (at, across) }
    }
}

impl Bar {
    /// From where to where it reaches, its error bar included.
    fn range(&self) -> (f64, f64) {
        let part = |of: fn(f64) -> bool| self.means.iter().filter(|mean| of(**mean)).sum::<f64>();
        let (below, above) = (part(|mean| mean < 0.0), part(|mean| mean > 0.0));
        (below.min(self.total), above.max(self.total + self.std.unwrap_or_default()))
    }

    /// `22.4 ± 2.1`
    fn words(&self, unit: &Unit) -> String {
        let decimals = peernet_statistics::number::decimals(self.total * unit.per_si, 3).min(3);
        let total = fixed(self.total * unit.per_si, decimals);
        match self.std {
            Some(std) => format!("{total} ± {}", fixed(std * unit.per_si, decimals)),
            None => total,
        }
    }
}

impl Stacked {
    /// Few bars with short labels stand upright.
    fn is_upright(&self) -> bool {
        let room = (SIZE.0 as i32 - 260) / self.bars.len().max(1) as i32 - 20;
        let fits = |words: &str, height: i32| width(words, height) <= room;
        self.bars.len() <= MOST_UPRIGHT
            && self.bars.iter().all(|bar| {
                bar.label.split(", ").all(|line| fits(line, TEXT)) && fits(&bar.words(&self.unit), SMALL)
            })
    }

    /// The labels' lines below upright bars.
    fn lines(&self) -> i32 {
        self.bars.iter().map(|bar| bar.label.split(", ").count()).max().unwrap_or(1) as i32
    }

    fn row(&self) -> i32 {
        if self.bars.len() > MANY { CLOSE } else { ROW }
    }

    fn header(&self) -> Header {
        let keys = self.stages.iter().map(|stage| Key::new(Swatch::Area(stage_fill(stage)), stage.clone()));
        Header { title: self.title.clone(), keys: keys.collect(), notes: self.notes.clone() }
    }

    fn range(&self) -> (f64, f64) {
        let ranges = self.bars.iter().map(Bar::range);
        let (lo, hi) = ranges.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or_default();
        (lo * self.unit.per_si, hi * self.unit.per_si)
    }

    fn draw_bar<DB: DrawingBackend>(
        &self,
        paper: &Paper<DB>,
        places: &Places,
        (bar, middle, half): (&Bar, i32, i32),
    ) -> Drawn<DB, (i32, i32)> {
        let shown = |value: f64| value * self.unit.per_si;
        let across = (middle - half, middle + half);
        let (mut below, mut above) = (0.0, 0.0);
        for (stage, mean) in self.stages.iter().zip(&bar.means).filter(|(_, mean)| **mean != 0.0) {
            let end = if *mean < 0.0 { &mut below } else { &mut above };
            let from = *end;
            *end += mean;
            let area = places.area((shown(from), shown(*end)), across);
            fill(paper, places.at_least(THIN, area), stage_fill(stage))?;
            // Parts are parted, so that neighbours of one grey do not run together.
            if from != 0.0 && places.extent(area) > 2 * THIN {
                let edge = [places.point(shown(from), across.0), places.point(shown(from), across.1)];
                paper.draw(&PathElement::new(edge, WHITE.stroke_width(PARTING)))?;
            }
        }
        let total = bar.total;
        let mut end = total.max(above);
        if let Some(std) = bar.std.filter(|std| *std > 0.0) {
            let (lo, hi) = (shown(total - std), shown(total + std));
            end = end.max(total + std);
            for (colour, wide) in [(WHITE, 13), (INK, 5)] {
                let style = colour.stroke_width(wide);
                let stem = [places.point(lo, middle), places.point(hi, middle)];
                paper.draw(&PathElement::new(stem, style))?;
                for value in [lo, hi].into_iter().filter(|value| places.values.has(*value)) {
                    let cap = [places.point(value, middle - CAP), places.point(value, middle + CAP)];
                    paper.draw(&PathElement::new(cap, style))?;
                }
            }
        }
        Ok(places.point(shown(end), middle))
    }

    fn draw_upright<DB: DrawingBackend>(&self, paper: &Paper<DB>, top: i32) -> Drawn<DB> {
        let extra = (self.lines() - 1) * TEXT;
        let (wide, high) = paper.dim_in_pixel();
        let (low, above) = self.range();
        // The words above the tallest bar are below the axis' title.
        let values = Frame::below(top, high as i32 - extra + 40, |(bottom, top)| {
            let plot = f64::from(bottom - top).max(f64::from(2 * WORDS));
            let room = (above - low) * f64::from(WORDS) / (plot - f64::from(WORDS));
            Axis::from_zero((low, above + room), (bottom, top))
        });
        let pixels = Frame::beside(&values, wide as i32);
        let frame = Frame { x: Axis::linear((0.0, 1.0), pixels), y: values };
        frame.draw_y(paper, (&self.unit.title, 0))?;
        let places = Places { values, upright: true };
        let step = (pixels.1 - pixels.0) / self.bars.len().max(1) as i32;
        for (number, bar) in self.bars.iter().enumerate() {
            let middle = pixels.0 + step * number as i32 + step / 2;
            let (x, y) = self.draw_bar(paper, &places, (bar, middle, (step * 3 / 10).min(140)))?;
            let look = style(SMALL, INK, HPos::Center, VPos::Bottom);
            text_on_ground(paper, &bar.words(&self.unit), (x, y - 14), look)?;
            for (line, words) in bar.label.split(", ").enumerate() {
                let at = (middle, values.pixels.0 + 24 + TEXT * line as i32);
                let look = style(TEXT, INK, HPos::Center, VPos::Top);
                text(paper, words.to_owned(), at, look)?;
            }
        }
        Ok(())
    }

    fn draw_lying<DB: DrawingBackend>(&self, paper: &Paper<DB>, top: i32) -> Drawn<DB> {
        let (wide, row) = (paper.dim_in_pixel().0 as i32, self.row());
        let height = if row == CLOSE { SMALL } else { TEXT };
        let widest = |words: &dyn Fn(&Bar) -> String, height: i32| {
            self.bars.iter().map(|bar| width(&words(bar), height)).max().unwrap_or_default()
        };
        let room = widest(&|bar| bar.label.clone(), height).min(wide * 2 / 5);
        let sums = widest(&|bar| bar.words(&self.unit), SMALL);
        let values = Axis::from_zero(self.range(), (40 + room + 24, wide - 60 - sums));
        let bottom = top + 10 + row * self.bars.len() as i32;
        // No axis of values goes upward here: rows do.
        let frame = Frame { x: values, y: Axis::linear((0.0, 1.0), (bottom + 6, top)) };
        frame.draw_upright_grid(paper)?;
        let places = Places { values, upright: false };
        let labels: Vec<&str> = self.bars.iter().map(|bar| bar.label.as_str()).collect();
        let labels = shorten_apart(&labels, height, room);
        for (number, (bar, label)) in self.bars.iter().zip(labels).enumerate() {
            let middle = top + 10 + row * number as i32 + row / 2;
            let look = style(height, INK, HPos::Left, VPos::Center);
            text(paper, label, (40, middle), look)?;
            let (x, y) = self.draw_bar(paper, &places, (bar, middle, row * 3 / 10))?;
            let look = style(SMALL, INK, HPos::Left, VPos::Center);
            text_on_ground(paper, &bar.words(&self.unit), (x + 18, y), look)?;
        }
        frame.draw_x(paper, &self.unit.title, |tick| tick.text.clone())
    }
}

impl Figure for Stacked {
    fn size(&self) -> (u32, u32) {
        if self.bars.is_empty() || self.is_upright() {
            return SIZE;
        }
        let header = self.header().height(SIZE.0 as i32);
        let height = header + self.row() * self.bars.len() as i32 + 200;
        (SIZE.0, height.max(0) as u32)
    }

    fn draw<DB: DrawingBackend>(&self, paper: &Paper<DB>) -> Drawn<DB> {
        let top = self.header().draw(paper)?;
        match self.is_upright() {
            _ if self.bars.is_empty() => nothing(paper, top),
            true => self.draw_upright(paper, top),
            false => self.draw_lying(paper, top),
        }
    }
}
