//! Rules for reading a `data.csv`, whichever program wrote it.

use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};

use crate::stage;

/// Number of rows at the beginning of a run that the figures of the paper leave out. In a file without the column
/// `warm-up`, these rows are the warm-up.
pub const PUBLISHED_WARM_UP_ROWS: usize = 5;
/// Number of bytes that are read at a time in search of the end of the last line.
const BUFFER_BYTES: usize = 64 * 1024;

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

/// Returns whether a file ends with a complete line: with a line feed that is not within a quoted cell. Afterwards the file
/// is read from its beginning.
///
/// # Errors
/// If the file cannot be read.
pub fn ends_with_line(file: &mut (impl Read + Seek)) -> io::Result<bool> {
    // The length of a device such as /dev/full is 0, although reading it never ends.
    let length = file.seek(SeekFrom::End(0))?;
    let mut last_byte = [0];
    if length > 0 {
        file.seek(SeekFrom::End(-1))?;
        file.read_exact(&mut last_byte)?;
    }
    file.rewind()?;
    // Only a file that ends with a line feed is read whole, so that a sparse file of many terabytes is not.
    if last_byte != *b"\n" {
        return Ok(false);
    }
    let mut reader = BufReader::with_capacity(BUFFER_BYTES, file.take(length));
    let mut is_quoted = false;
    loop {
        let bytes = reader.fill_buf()?;
        if bytes.is_empty() {
            break;
        }
        // A quote within a quoted cell is doubled, so that it changes nothing.
        bytes.iter().for_each(|byte| is_quoted ^= *byte == b'"');
        let count = bytes.len();
        reader.consume(count);
    }
    file.rewind()?;
    Ok(!is_quoted)
}
