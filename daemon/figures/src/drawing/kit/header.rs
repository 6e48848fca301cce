//! What stands above a plot: its title, the key, notes.

use plotters::element::{DashedPathElement, PathElement, Rectangle};
use plotters::prelude::DrawingBackend;
use plotters::style::text_anchor::{HPos, VPos};
use plotters::style::{Color, RGBColor};

use super::canvas::{Drawn, Paper, SMALL, TEXT, style};
use super::colour::{INK, QUIET};
use super::fill::{Fill, fill};
use super::frame::EDGE;
use super::mark::Mark;
use super::text::{shorten, text, width, wrap};

/// Distance between two lines of text, pixels.
const LINE: i32 = 70;
/// Distance between two lines of notes.
const NOTE: i32 = 56;
/// Width of a sample of what a key explains.
const SAMPLE: i32 = 90;
/// The same of a line of long dashes: a gap on each side of the mark.
const LONG: i32 = 150;
/// From a sample to its words, and from those to the next sample.
const GAP: i32 = 22;

/// What a key shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::drawing) enum Swatch {
    /// A filled area.
    Area(Fill),
    /// A line, dashed or not.
    Line(RGBColor, bool),
    /// A mark on a line.
    Mark(RGBColor, Mark),
    /// A mark on the line that is its own.
    Curve(RGBColor, Mark),
    /// A pale area with a mark in black.
    Shape(RGBColor, Mark),
}

impl Swatch {
    fn width(self) -> i32 {
        if matches!(self, Self::Curve(_, Mark::Diamond)) { LONG } else { SAMPLE }
    }
}

/// A sample and what it means.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::drawing) struct Key {
    pub(in crate::drawing) swatch: Swatch,
    pub(in crate::drawing) text: String,
}

impl Key {
    pub(in crate::drawing) fn new(swatch: Swatch, text: impl Into<String>) -> Self {
        Self { swatch, text: text.into() }
    }
}

/// What stands above a plot.
#[derive(Clone, Debug, Default, PartialEq)]
pub(in crate::drawing) struct Header {
    /// Nothing where it is empty.
    pub(in crate::drawing) title: String,
    /// Side by side as long as there is room.
    pub(in crate::drawing) keys: Vec<Key>,
    /// Each begins a line.
    pub(in crate::drawing) notes: Vec<String>,
}

impl Header {
    /// How many pixels it takes on paper of a width.
    pub(in crate::drawing) fn height(&self, paper: i32) -> i32 {
        let keys = self.places(paper).last().map_or(0, |(_, line)| line + 1);
        let notes = self.notes(paper).len() as i32;
        EDGE / 2 + LINE * (i32::from(!self.title.is_empty()) + keys) + NOTE * notes
    }

    /// Where each key stands: pixels from the left, and which line of keys.
    fn places(&self, paper: i32) -> Vec<(i32, i32)> {
        let (mut x, mut line) = (EDGE, 0);
        let mut places = Vec::new();
        for key in &self.keys {
            let wide = key.swatch.width() + GAP + width(&key.text, TEXT);
            if x > EDGE && x + wide > paper - EDGE {
                (x, line) = (EDGE, line + 1);
            }
            places.push((x, line));
            x += wide + 2 * GAP;
        }
        places
    }

    fn notes(&self, paper: i32) -> Vec<String> {
        self.notes.iter().flat_map(|note| wrap(note, SMALL, paper - 2 * EDGE)).collect()
    }

    /// Draws it; returns where the next thing may begin.
    pub(in crate::drawing) fn draw<DB: DrawingBackend>(&self, paper: &Paper<DB>) -> Drawn<DB, i32> {
        let wide = paper.dim_in_pixel().0 as i32;
        let mut y = EDGE / 2;
        if !self.title.is_empty() {
            let title = shorten(&self.title, TEXT, wide - 2 * EDGE);
            text(paper, title, (EDGE, y + LINE / 2), style(TEXT, INK, HPos::Left, VPos::Center))?;
            y += LINE;
        }
        let places = self.places(wide);
        for (key, (x, line)) in self.keys.iter().zip(&places) {
            let at = y + LINE * line + LINE / 2;
            sample(paper, (*x, at), key.swatch)?;
            let from = x + key.swatch.width() + GAP;
            let words = shorten(&key.text, TEXT, wide - from - EDGE / 2);
            text(paper, words, (from, at), style(TEXT, INK, HPos::Left, VPos::Center))?;
        }
        y += LINE * places.last().map_or(0, |(_, line)| line + 1);
        for note in self.notes(wide) {
            let look = style(SMALL, QUIET, HPos::Left, VPos::Center);
            text(paper, note, (EDGE, y + NOTE / 2), look)?;
            y += NOTE;
        }
        Ok(y)
    }
}

fn sample<DB: DrawingBackend>(paper: &Paper<DB>, (x, y): (i32, i32), swatch: Swatch) -> Drawn<DB> {
    let wide = swatch.width();
    let line = [(x, y), (x + wide, y)];
    match swatch {
        Swatch::Area(area) => fill(paper, [(x, y - 22), (x + wide, y + 22)], area),
        Swatch::Line(colour, false) => paper.draw(&PathElement::new(line, colour.stroke_width(6))),
        Swatch::Line(colour, true) => {
            paper.draw(&DashedPathElement::new(line, 22, 12, colour.stroke_width(6)))
        }
        Swatch::Mark(colour, mark) => {
            if mark != Mark::Cross {
                paper.draw(&PathElement::new(line, colour.stroke_width(5)))?;
            }
            mark.draw(paper, (x + wide / 2, y), colour)
        }
        Swatch::Shape(colour, mark) => {
            let area = [(x, y - 22), (x + wide, y + 22)];
            paper.draw(&Rectangle::new(area, colour.mix(0.35).filled()))?;
            paper.draw(&Rectangle::new(area, colour.stroke_width(4)))?;
            mark.draw(paper, (x + wide / 2, y), INK)
        }
        Swatch::Curve(colour, mark) => {
            mark.draw_line(paper, line.to_vec(), colour)?;
            mark.draw(paper, (x + wide / 2, y), colour)
        }
    }
}
