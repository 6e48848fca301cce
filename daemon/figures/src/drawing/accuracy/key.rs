//! What the numbers of the points stand for, with what can be read of each, below the plot.

use peernet_statistics::number::{fixed, significant};
use plotters::prelude::DrawingBackend;
use plotters::style::text_anchor::{HPos, VPos};

use super::super::kit::{Drawn, INK, Paper, QUIET, SIZE, SMALL, shorten_apart, style, text, width};
use super::Accuracy;

/// Distance between two lines.
const LINE: i32 = 58;
/// Distance from the edges of the paper.
pub(super) const EDGE: i32 = 40;
/// From the edge to the names, and between two columns.
const NUMBER: i32 = 76;
const GAP: i32 = 44;

/// A line: what it is and its cells.
type Line = (String, Vec<String>);

impl Accuracy {
    /// Title line and a line for each point; nothing without points.
    fn key_lines(&self) -> Vec<Line> {
        let has_late = self.shown().any(|(score, _)| score.late().is_some());
        let show = |value: f64| significant(value * self.unit.per_si);
        let cells = |[accuracy, median, late]: [String; 3]| {
            [accuracy, median].into_iter().chain(has_late.then_some(late)).collect::<Vec<_>>()
        };
        let symbol = &self.unit.symbol;
        let titles = cells(["accuracy, %".to_owned(), format!("median, {symbol}"), format!("p95, {symbol}")]);
        let lines = self.shown().map(|(score, [_, share, _])| {
            let late = score.late().map_or_else(|| "—".to_owned(), show);
            (score.label.clone(), cells([fixed(share, 1), show(score.median), late]))
        });
        let lines: Vec<Line> = lines.collect();
        let title = (!lines.is_empty()).then(|| (String::new(), titles));
        title.into_iter().chain(lines).collect()
    }

    /// How many pixels the key takes.
    pub(super) fn key_height(&self) -> i32 {
        let lines = self.shown().count() as i32;
        if lines == 0 { 0 } else { (lines + 1) * LINE + EDGE }
    }

    pub(super) fn draw_key<DB: DrawingBackend>(&self, paper: &Paper<DB>, top: i32) -> Drawn<DB> {
        let lines = self.key_lines();
        let columns = lines.first().map_or(0, |(_, cells)| cells.len());
        let wide = |column: usize| {
            lines.iter().map(|(_, cells)| width(&cells[column], SMALL)).max().unwrap_or_default()
        };
        // Right ends, from the last column on.
        let mut ends = vec![SIZE.0 as i32 - EDGE; columns];
        for column in (0..columns.saturating_sub(1)).rev() {
            ends[column] = ends[column + 1] - wide(column + 1) - GAP;
        }
        let first = ends.first().map_or(SIZE.0 as i32 - EDGE, |end| end - wide(0) - GAP);
        let labels: Vec<&str> = lines.iter().map(|(label, _)| label.as_str()).collect();
        let labels = shorten_apart(&labels, SMALL, first - EDGE - NUMBER);
        for (number, (label, (_, cells))) in labels.iter().zip(&lines).enumerate() {
            let middle = top + LINE * number as i32 + LINE / 2;
            let colour = if number == 0 { QUIET } else { INK };
            let look = |side| style(SMALL, colour, side, VPos::Center);
            if number > 0 {
                text(paper, number.to_string(), (EDGE + NUMBER - 24, middle), look(HPos::Right))?;
                text(paper, label.clone(), (EDGE + NUMBER, middle), look(HPos::Left))?;
            }
            for (cell, end) in cells.iter().zip(&ends) {
                text(paper, cell.clone(), (*end, middle), look(HPos::Right))?;
            }
        }
        Ok(())
    }
}
