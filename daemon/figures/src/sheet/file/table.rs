//! Table below the plots: the meaning of the numbers in them.

use super::draw::text;
use super::{EDGE, SMALL, WIDTH};
use crate::look::{INK, INK_2};
use crate::plot::{Anchor, Table};
use crate::svg::Writer;
use crate::text::{shorten_distinctly, width};

/// Distance between two lines, points.
const LINE: f64 = 9.0;
/// Distance from the edge to the names, and between two columns.
const NUMBER: f64 = 11.0;
const GAP: f64 = 6.5;

/// Returns the height of the table, points.
pub(super) fn height(table: &Table) -> f64 {
    if table.lines.is_empty() { 0.0 } else { (table.lines.len() + 1) as f64 * LINE + EDGE }
}

/// Draws numbered lines with their names at the left and their cells at the right.
pub(super) fn draw(svg: &mut Writer, table: &Table, top: f64) {
    if table.lines.is_empty() {
        return;
    }
    let columns = table.titles.len();
    let cells = |column: usize| {
        let cells = table.lines.iter().filter_map(move |(_, cells)| cells.get(column));
        cells.chain(table.titles.get(column)).map(|cell| width(cell, SMALL)).fold(0.0, f64::max)
    };
    // Right ends of the columns, from the last to the first.
    let mut ends = vec![WIDTH - EDGE; columns];
    for column in (0..columns.saturating_sub(1)).rev() {
        ends[column] = ends[column + 1] - cells(column + 1) - GAP;
    }
    let first = ends.first().map_or(WIDTH - EDGE, |end| end - cells(0) - GAP);
    let names: Vec<&str> = table.lines.iter().map(|(name, _)| name.as_str()).collect();
    let names = shorten_distinctly(&names, SMALL, first - EDGE - NUMBER);
    let base = |line: usize| top + LINE * (line as f64 + 0.75);
    for (title, end) in table.titles.iter().zip(&ends) {
        text(svg, title, (*end, base(0)), (SMALL, INK_2.light, Anchor::End));
    }
    for (number, (name, (_, cells))) in names.iter().zip(&table.lines).enumerate() {
        let base = base(number + 1);
        text(svg, &(number + 1).to_string(), (EDGE + NUMBER - 3.5, base), (SMALL, INK.light, Anchor::End));
        text(svg, name, (EDGE + NUMBER, base), (SMALL, INK.light, Anchor::Start));
        for (cell, end) in cells.iter().zip(&ends) {
            text(svg, cell, (*end, base), (SMALL, INK.light, Anchor::End));
        }
    }
}
