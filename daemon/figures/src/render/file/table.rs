//! Table below the plots, which explains the numbers beside points.

use super::draw::text;
use super::{EDGE, SMALL, WIDTH};
use crate::look::{INK, INK_2};
use crate::plot::{Anchor, Table};
use crate::svg::Writer;
use crate::text::{shorten_distinctly, width};

/// Distance between two lines, points.
const LINE: f64 = 9.0;
/// Width of the column of numbers, including the distance from the names, points.
const NUMBER_WIDTH: f64 = 11.0;
/// Distance between a number and the name at its right, points.
const NUMBER_DISTANCE: f64 = 3.5;
/// Distance between two columns, points.
const GAP: f64 = 6.5;

/// Returns the height of the table, points.
pub(super) fn height(table: &Table) -> f64 {
    if table.lines.is_empty() { 0.0 } else { (table.lines.len() + 1) as f64 * LINE + EDGE }
}

/// Draws numbered lines. Each line has its name at the left and its cells at the right.
pub(super) fn draw(svg: &mut Writer, table: &Table, top: f64) {
    if table.lines.is_empty() {
        return;
    }
    let columns = table.titles.len();
    let column_width = |column: usize| {
        let cells = table.lines.iter().filter_map(move |(_, cells)| cells.get(column));
        cells.chain(table.titles.get(column)).map(|cell| width(cell, SMALL)).fold(0.0, f64::max)
    };
    // Right ends of the columns, computed from the last column to the first.
    let mut ends = vec![WIDTH - EDGE; columns];
    for column in (0..columns.saturating_sub(1)).rev() {
        ends[column] = ends[column + 1] - column_width(column + 1) - GAP;
    }
    let end_of_names = ends.first().map_or(WIDTH - EDGE, |end| end - column_width(0) - GAP);
    let names: Vec<&str> = table.lines.iter().map(|(name, _)| name.as_str()).collect();
    let names = shorten_distinctly(&names, SMALL, end_of_names - EDGE - NUMBER_WIDTH);
    let baseline = |line: usize| top + LINE * (line as f64 + 0.75);
    for (title, end) in table.titles.iter().zip(&ends) {
        text(svg, title, (*end, baseline(0)), (SMALL, INK_2.light, Anchor::End));
    }
    for (number, (name, (_, cells))) in (1..).zip(names.iter().zip(&table.lines)) {
        let baseline = baseline(number);
        text(
            svg,
            &number.to_string(),
            (EDGE + NUMBER_WIDTH - NUMBER_DISTANCE, baseline),
            (SMALL, INK.light, Anchor::End),
        );
        text(svg, name, (EDGE + NUMBER_WIDTH, baseline), (SMALL, INK.light, Anchor::Start));
        for (cell, end) in cells.iter().zip(&ends) {
            text(svg, cell, (*end, baseline), (SMALL, INK.light, Anchor::End));
        }
    }
}
