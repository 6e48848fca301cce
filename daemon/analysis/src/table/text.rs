//! Tables for the terminal: columns as wide as their longest cell.

use peernet_sample::printable_line;

use super::Table;

/// Returns a table as text: rows of cells under a header. The first column is text; the other columns are numbers and
/// aligned right.
pub fn text(header: &[&str], rows: &[Vec<String>]) -> String {
    lines(&header.iter().map(|&cell| cell.to_owned()).collect::<Vec<_>>(), rows, 1)
}

/// Returns the text of a table. An asterisk follows the marked cell.
pub(super) fn table(table: &Table) -> String {
    let (mut header, mut rows) = (table.header.clone(), table.rows.clone());
    if let Some((marked_row, column)) = table.marked {
        // The other cells of the column end with blanks, so that the numbers stay aligned.
        header[column].push_str("  ");
        for (row, cells) in rows.iter_mut().enumerate() {
            cells[column].push_str(if row == marked_row { " *" } else { "  " });
        }
    }
    lines(&header, &rows, table.label_columns)
}

/// Returns lines of aligned cells. The first `label_columns` columns are aligned left, the others right.
fn lines(header: &[String], rows: &[Vec<String>], label_columns: usize) -> String {
    let printable =
        |cells: &[String]| cells.iter().map(|cell| printable_line(cell).into_owned()).collect::<Vec<_>>();
    let (header, rows) = (printable(header), rows.iter().map(|row| printable(row)).collect::<Vec<_>>());
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count());
        cells.chain([header[column].chars().count()]).max().unwrap_or_default()
    };
    let widths: Vec<usize> = (0..header.len()).map(width).collect();
    let line = |cells: &[String]| {
        let cells = cells.iter().zip(&widths).enumerate();
        let cells = cells.map(|(column, (cell, width))| {
            if column < label_columns { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
        });
        cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    std::iter::once(line(&header)).chain(rows.iter().map(|row| line(row))).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_aligned() {
        let rows = [vec!["edge/full".to_owned(), "21.60".to_owned()], vec!["ä".to_owned(), "—".to_owned()]];
        assert_eq!(
            text(&["pipeline", "p50 ms"], &rows),
            "pipeline   p50 ms\nedge/full   21.60\nä               —"
        );
    }

    #[test]
    fn labels_are_left_aligned_and_mark_keeps_alignment() {
        let cells = |cells: [&str; 4]| cells.map(str::to_owned).to_vec();
        let table = Table {
            header: cells(["model", "network", "total", "success"]),
            label_columns: 2,
            rows: vec![cells(["s", "LAN", "9.50", "0.0"]), cells(["medium", "5G", "100.25", "50.0"])],
            marked: Some((0, 2)),
        };
        let expected = "model   network   total    success\ns       LAN        9.50 *      0.0\nmedium  5G       100.25       50.0";
        assert_eq!(table.text(), expected);
    }

    #[test]
    fn cells_cannot_break_the_table() {
        let rows = [vec!["a\nb\u{1b}[2J".to_owned(), "1".to_owned()]];
        assert_eq!(text(&["x\ty", "n"], &rows), "x y      n\na b [2J  1");
    }
}
