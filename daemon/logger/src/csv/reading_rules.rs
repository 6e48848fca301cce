//! Rules for reading a `data.csv`, whichever program wrote it.

use std::io::{self, Read, Seek, SeekFrom};

use crate::stage;

/// Number of rows at the beginning of a run that the figures of the paper leave out. In a file without the column
/// `warm-up`, these rows are the warm-up.
pub const PUBLISHED_WARM_UP_ROWS: usize = 5;

/// Returns the name of the column with this cell in the header: without the suffix `_val` if it is the column of a
/// stage. The paper's original program joins the names of nested nodes by underscores (`inference_backbone`), and adds
/// `_val` for the value of a node that has nested nodes (`inference_val`).
pub fn column_name(cell: &str) -> &str {
    let name = cell.trim();
    name.strip_suffix("_val").filter(|name| stage::ORDER.iter().any(|stage| stage == name)).unwrap_or(name)
}

/// Returns whether a cell of the column `warm-up` marks its row as warm-up. An empty cell does not. `None` if the cell
/// contains neither a number nor a truth value.
pub fn is_warm_up(cell: &str) -> Option<bool> {
    match cell.trim() {
        // The CSV export of earlier dashboards writes truth values.
        "true" => Some(true),
        "false" | "" => Some(false),
        number => number.parse::<f64>().ok().map(|number| number != 0.0),
    }
}

/// Returns whether a file ends with a complete line. Afterwards the file is read from its beginning.
///
/// # Errors
/// If the file cannot be read.
pub fn ends_with_line(file: &mut (impl Read + Seek)) -> io::Result<bool> {
    let mut last_byte = [0];
    if file.seek(SeekFrom::End(0))? > 0 {
        file.seek(SeekFrom::End(-1))?;
        file.read_exact(&mut last_byte)?;
    }
    file.rewind()?;
    Ok(last_byte == *b"\n")
}
