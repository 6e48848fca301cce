//! One quantity here and there: the same model on the robot and in the cloud, side by side.

mod density;
mod violin;

use peernet_statistics::number::{counted, fixed, significant};
use plotters::element::Rectangle;
use plotters::prelude::DrawingBackend;
use plotters::style::text_anchor::{HPos, VPos};
use plotters::style::{Color, WHITE};

use super::histogram::{nothing, range};
use super::kit::{
    Axis, Drawn, Figure, Frame, Header, INK, Key, Mark, Paper, QUIET, SERIES, SIZE, SMALL, Swatch, TEXT,
    Unit, shorten_apart, style, text, width,
};
use density::density;
use peernet_analysis::order::Ordered;

/// Up to how many values each is drawn.
const MOST_POINTS: usize = 60;
/// Room for single points above the axis' range, below what is written there.
const NEAR: f64 = 1.05;
/// From this ratio of the largest to the smallest median on, the axis is logarithmic.
const WIDE: f64 = 30.0;
/// Most sides that can be told apart.
pub const MOST_SIDES: usize = SERIES.len();
/// Most groups that a column has room for.
pub const MOST_GROUPS: usize = 12;

/// Distributions side by side, in groups.
#[derive(Clone, Debug, PartialEq)]
pub struct Paired {
    /// What is shown.
    pub title: String,
    /// What stands along the vertical axis.
    pub unit: Unit,
    /// What is side by side in each group: at most four.
    pub sides: Vec<String>,
    /// One for each model: at most twelve.
    pub groups: Vec<Group>,
    /// What is left out and so on.
    pub notes: Vec<String>,
}

/// A group: one model.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Its name.
    pub name: String,
    /// The values of each side, SI units; empty where there are none.
    pub values: Vec<Ordered>,
}

impl Group {
    /// `2.5 ×`: the first side's median over the second's, where there are two.
    fn ratio(&self) -> Option<String> {
        let [first, second] = self.values.as_slice() else { return None };
        let (first, second) = (first.median()?, second.median()?);
        (first > 0.0 && second > 0.0).then(|| format!("{} ×", significant(first / second)))
    }
}

impl Paired {
    fn header(&self) -> Header {
        let looks = SERIES.into_iter().zip(Mark::ALL);
        let key = |(name, (colour, mark)): (&String, _)| Key::new(Swatch::Shape(colour, mark), name.clone());
        let mut notes = self.notes.clone();
        if !self.has_room_for_counts() {
            let counts = || self.groups.iter().flat_map(|group| &group.values).map(Ordered::len);
            let ends = counts().filter(|count| *count > 0).min().zip(counts().max());
            notes.extend(ends.map(|(least, most)| {
                let [least, most] = [least, most].map(|count| fixed(count as f64, 0));
                if least == most { format!("n = {most} each") } else { format!("n = {least} to {most} each") }
            }));
        }
        if self.groups.iter().any(|group| group.ratio().is_some()) {
            notes.push(format!("above a pair: median {} ÷ {}", self.sides[0], self.sides[1]));
        }
        if self.groups.iter().flat_map(|group| &group.values).any(|values| self.beyond(values) > 0) {
            notes.push("+ above: so many values are larger than shown".to_owned());
        }
        let below = self
            .groups
            .iter()
            .flat_map(|group| &group.values)
            .map(|values| self.below(values))
            .sum::<usize>();
        if below > 0 {
            notes.push(format!("smaller than shown: {}", counted(below as u64, "value")));
        }
        Header { title: self.title.clone(), keys: self.sides.iter().zip(looks).map(key).collect(), notes }
    }

    /// Whether the count of each distribution has room below it.
    fn has_room_for_counts(&self) -> bool {
        let sides = self.groups.iter().map(|group| group.values.len()).max().unwrap_or(1);
        let room = (SIZE.0 as i32 - 260) * 9 / 10 / (self.groups.len() * sides).max(1) as i32 - 12;
        let all = self.groups.iter().flat_map(|group| &group.values);
        all.into_iter().all(|values| width(&n_of(values), SMALL) <= room)
    }

    /// What the axis holds: every distribution but for tails that would squeeze the rest.
    fn shown(&self) -> Option<(f64, f64)> {
        let ends = |values: &Ordered| {
            let (lo, hi) = range(values)?;
            // A single point above zero squeezes nothing from below.
            let least = values.values().first().copied().filter(|least| *least > 0.0);
            Some((least.filter(|_| values.len() <= MOST_POINTS).unwrap_or(lo), hi))
        };
        let all = self.groups.iter().flat_map(|group| &group.values).filter_map(ends);
        all.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).filter(|(lo, hi)| lo.is_finite() && hi.is_finite())
    }

    /// Whether an even axis would press most of it onto its base: then the axis is logarithmic.
    fn is_wide(&self) -> bool {
        let medians = self.groups.iter().flat_map(|group| &group.values).filter_map(Ordered::median);
        let medians: Ordered = medians.collect();
        let ends = medians.values().first().zip(medians.values().last());
        self.shown().is_some_and(|(lo, _)| lo > 0.0) && ends.is_some_and(|(lo, hi)| *hi >= WIDE * lo)
    }

    /// The largest value that is shown of some: single points as far as the axis goes, shapes without their tails.
    fn highest(&self, values: &Ordered) -> Option<f64> {
        let (_, hi) = range(values)?;
        if values.len() > MOST_POINTS {
            return Some(hi);
        }
        let (_, most) = self.shown()?;
        values.values().iter().rev().copied().find(|value| *value <= most * NEAR)
    }

    /// How many values are above what is shown of them.
    fn beyond(&self, values: &Ordered) -> usize {
        let count = |highest| values.values().iter().filter(|value| **value > highest).count();
        self.highest(values).map_or(0, count)
    }

    /// How many values are below what is shown of them.
    fn below(&self, values: &Ordered) -> usize {
        let lowest = if values.len() > MOST_POINTS { range(values) } else { self.shown() };
        let count = |(lowest, _)| values.values().iter().filter(|value| **value < lowest).count();
        lowest.map_or(0, count)
    }

    fn draw_one<DB: DrawingBackend>(
        &self,
        paper: &Paper<DB>,
        frame: &Frame,
        (values, side, middle, half): (&Ordered, usize, i32, i32),
    ) -> Drawn<DB> {
        let (colour, mark) = (SERIES[side % MOST_SIDES], Mark::ALL[side % MOST_SIDES]);
        let y = |value: f64| frame.y.at(value * self.unit.per_si);
        let Some((lo, hi)) = range(values) else { return Ok(()) };
        let highest = self.highest(values);
        let hill = if self.is_wide() { log_density(values, (lo, hi)) } else { density(values, (lo, hi)) };
        let wide = |dense: f64| (f64::from(half) * dense).round() as i32;
        let mut places: Vec<(i32, i32)> =
            hill.iter().map(|(value, dense)| (y(*value), wide(*dense))).collect();
        // Several places of one row of pixels are its widest one.
        places.dedup_by(|next, kept| {
            let same = next.0 == kept.0;
            kept.1 = if same { kept.1.max(next.1) } else { kept.1 };
            same
        });
        if places.len() > 1 && values.len() > MOST_POINTS {
            violin::draw(paper, &places, middle, colour)?;
        } else {
            let lowest = self.shown().map_or(lo, |(lowest, _)| lowest);
            let is_shown = |value: &&f64| **value >= lowest && highest.is_some_and(|most| **value <= most);
            let shown = values.values().iter().filter(is_shown);
            for (number, value) in shown.enumerate() {
                // Spread evenly to the sides, so that each is seen; the same every time.
                let aside = (number as f64 * 0.618_034).fract() - 0.5;
                let at = (middle + (aside * f64::from(half)) as i32, y(*value));
                mark.draw(paper, at, colour)?;
            }
        }
        if values.len() >= 4
            && let Some((low, high)) = values.quantile(0.25).zip(values.quantile(0.75))
        {
            let bar = [(middle - 9, y(high)), (middle + 9, y(low))];
            paper.draw(&Rectangle::new(
                [(bar[0].0 - 4, bar[0].1 - 4), (bar[1].0 + 4, bar[1].1 + 4)],
                WHITE.filled(),
            ))?;
            paper.draw(&Rectangle::new(bar, colour.filled()))?;
        }
        if let Some(median) = values.median() {
            let at = (middle, y(median));
            mark.draw(paper, at, INK)?;
        }
        let above = self.beyond(values);
        if let Some(highest) = highest.filter(|_| above > 0) {
            let look = style(SMALL, QUIET, HPos::Center, VPos::Bottom);
            // Clear of the highest point.
            let at = (middle, y(highest) - 20);
            text(paper, format!("+{}", fixed(above as f64, 0)), at, look)?;
        }
        Ok(())
    }
}

/// The density of the logarithms: as wide as it is dense on a logarithmic axis.
fn log_density(values: &Ordered, (lo, hi): (f64, f64)) -> Vec<(f64, f64)> {
    let logarithms: Ordered =
        values.values().iter().filter(|value| **value > 0.0).map(|value| value.ln()).collect();
    density(&logarithms, (lo.ln(), hi.ln())).into_iter().map(|(at, dense)| (at.exp(), dense)).collect()
}

/// `n = 1,200`
fn n_of(values: &Ordered) -> String {
    format!("n = {}", fixed(values.len() as f64, 0))
}

impl Figure for Paired {
    fn draw<DB: DrawingBackend>(&self, paper: &Paper<DB>) -> Drawn<DB> {
        let top = self.header().draw(paper)?;
        let Some((lo, hi)) = self.shown() else { return nothing(paper, top) };
        let (lo, hi) = (lo * self.unit.per_si, hi * self.unit.per_si);
        let counts = if self.has_room_for_counts() { SMALL + 6 } else { 0 };
        let y = Frame::below(top, SIZE.1 as i32 + 70 - counts, |pixels| {
            if self.is_wide() {
                // Room for the ratios above, as below.
                let room = (hi / lo).powf(0.12);
                Axis::logarithmic((lo / room.sqrt(), hi * room), pixels)
            } else {
                Axis::from_zero((lo, hi * 1.12), pixels)
            }
        });
        let pixels = Frame::beside(&y, SIZE.0 as i32);
        let frame = Frame { x: Axis::linear((0.0, 1.0), pixels), y };
        frame.draw_y(paper, (&self.unit.title, 0))?;
        let step = (pixels.1 - pixels.0) / self.groups.len().max(1) as i32;
        let fit = self.groups.iter().all(|group| width(&group.name, TEXT) <= step - 12);
        let height = if fit { TEXT } else { SMALL };
        let names: Vec<&str> = self.groups.iter().map(|group| group.name.as_str()).collect();
        let names = shorten_apart(&names, height, step - 12);
        for (number, (group, name)) in self.groups.iter().zip(names).enumerate() {
            let left = pixels.0 + step * number as i32;
            let lane = step * 9 / 10 / group.values.len().max(1) as i32;
            for (side, values) in group.values.iter().enumerate() {
                let middle = left + step / 20 + lane * side as i32 + lane / 2;
                self.draw_one(paper, &frame, (values, side, middle, (lane * 2 / 5).min(130)))?;
                if counts > 0 && !values.is_empty() {
                    let look = style(SMALL, QUIET, HPos::Center, VPos::Top);
                    text(paper, n_of(values), (middle, y.pixels.0 + 18), look)?;
                }
            }
            let at = (left + step / 2, y.pixels.0 + 24 + counts);
            text(paper, name, at, style(height, INK, HPos::Center, VPos::Top))?;
            if let Some(ratio) = group.ratio() {
                let at = (left + step / 2, y.pixels.1 + 4);
                text(paper, ratio, at, style(SMALL, INK, HPos::Center, VPos::Top))?;
            }
        }
        Ok(())
    }
}
