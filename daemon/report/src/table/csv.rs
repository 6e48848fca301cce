//! CSV.

use std::path::Path;

use crate::WriteError;

/// Writes a file of comma-separated values: a header and rows of as many cells.
pub(crate) fn csv(
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
