//! Tables as comma-separated values.

use std::path::Path;

use crate::WriteError;

/// Writes a file of comma-separated values: a header and rows with the same number of cells.
pub(crate) fn write_csv(
    path: &Path,
    header: &[&str],
    rows: impl Iterator<Item = Vec<String>>,
) -> Result<(), WriteError> {
    let mut file = csv::Writer::from_path(path).map_err(WriteError::at(path))?;
    file.write_record(header).map_err(WriteError::at(path))?;
    for row in rows {
        file.write_record(row).map_err(WriteError::at(path))?;
    }
    file.flush().map_err(WriteError::at(path))
}

/// Returns comma-separated values as text: a header and rows with the same number of cells.
///
/// # Panics
/// If a row has more or fewer cells than the header.
pub fn csv_text(header: &[&str], rows: &[Vec<String>]) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let result =
        writer.write_record(header).and_then(|()| rows.iter().try_for_each(|row| writer.write_record(row)));
    result.expect("all rows have as many cells as the header");
    let bytes = writer.into_inner().expect("writing to memory does not fail");
    String::from_utf8(bytes).expect("the cells are UTF-8")
}
