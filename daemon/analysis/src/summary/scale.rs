//! Scale in which the numbers of a column are shown.

use peernet_logger::{Unit, stage};
use peernet_statistics::number::{BITS_PER_MB, decimals, fixed, milliseconds, significant, throughput};

/// Names of columns other than the stages for which [`is_duration`] returns true.
const FURTHER_DURATION_COLUMNS: [&str; 7] = [
    "capture",
    "transform",
    "capture_capture-ipc",
    "restart",
    "capture_capture-restart",
    "actuation_actuation-ipc",
    "actuation_actuation-restart",
];

/// Suffix of the column with the value of a node that has both a value and children.
const VALUE_SUFFIX: &str = "_val";

/// Scale in which the numbers of a column are shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Seconds, shown as milliseconds.
    Milliseconds,
    /// Bits per second, shown as megabytes per second.
    MegabytesPerSecond,
    /// Whole bytes.
    Bytes,
    /// Numbers in the unit of the column.
    AsMeasured,
}

impl Scale {
    /// Returns the scale of a column. The scale of a standard column follows from its name, the scale of another column
    /// from the unit that was logged with its values. A second node with the name of a standard column, such as
    /// `upload_2`, has the scale of that column if no unit was logged.
    pub fn for_column(column: &str, unit: Option<&str>) -> Self {
        // Unlike the names for which `is_duration` returns true, these names must match exactly: `total_2` can have any
        // unit.
        let is_duration_of_iteration =
            ["lateness", "total", "stages-total", "unattributed"].contains(&column);
        match column {
            _ if is_duration_of_iteration || is_duration(column) => Self::Milliseconds,
            "upload-throughput" | "download-throughput" => Self::MegabytesPerSecond,
            "upload-bytes" | "download-bytes" | "upload-logger-bytes" | "download-logger-bytes" => {
                Self::Bytes
            }
            _ => match unit {
                Some(unit) => Self::for_unit(unit),
                None if is_duration(without_number(column)) => Self::Milliseconds,
                None => Self::AsMeasured,
            },
        }
    }

    /// Returns the scale of numbers that were logged in this unit.
    pub fn for_unit(unit: &str) -> Self {
        let is_symbol_of = |known_unit: &Unit| unit == known_unit.symbol();
        match unit {
            _ if is_symbol_of(&Unit::SECONDS) => Self::Milliseconds,
            _ if is_symbol_of(&Unit::BITS_PER_SECOND) => Self::MegabytesPerSecond,
            _ if is_symbol_of(&Unit::BYTES) => Self::Bytes,
            _ => Self::AsMeasured,
        }
    }

    /// Returns the symbol of the unit in which numbers are shown. Numbers that are shown as measured have the unit in
    /// which they were logged.
    pub const fn symbol(self, logged_unit: &str) -> &str {
        match self {
            Self::Milliseconds => "ms",
            Self::MegabytesPerSecond => "MB/s",
            Self::Bytes => "B",
            Self::AsMeasured => logged_unit,
        }
    }

    /// Returns the factor from a value in SI units to the number that is shown.
    pub const fn factor(self) -> f64 {
        match self {
            Self::Milliseconds => 1e3,
            Self::MegabytesPerSecond => 1.0 / BITS_PER_MB,
            Self::Bytes | Self::AsMeasured => 1.0,
        }
    }

    /// Returns the number of decimals of all numbers in a table's row, from the median in this row: the median has
    /// three significant digits. Numbers of bytes have no decimals.
    pub fn decimals(self, median: f64) -> usize {
        if self == Self::Bytes { 0 } else { decimals(median * self.factor(), 3) }
    }

    /// Formats a single value without its unit: three significant digits, or whole bytes.
    pub fn format(self, value: f64) -> String {
        match self {
            Self::Milliseconds => milliseconds(value),
            Self::MegabytesPerSecond => throughput(value),
            Self::Bytes => fixed(value, 0),
            Self::AsMeasured => significant(value),
        }
    }
}

/// Returns whether the values of a column are durations in seconds, even if no unit was logged, as in files of other
/// programs. The same holds for these names with a number, such as `upload_2`.
fn is_duration(column: &str) -> bool {
    stage::ORDER.iter().any(|stage| stage == column) || FURTHER_DURATION_COLUMNS.contains(&column)
}

/// Returns the name of a column without an appended number and [`VALUE_SUFFIX`]: `upload` for
/// `upload_2` and for `upload_2_val`.
fn without_number(column: &str) -> &str {
    let column = column.strip_suffix(VALUE_SUFFIX).unwrap_or(column);
    let is_number = |ending: &str| ending.bytes().all(|byte| byte.is_ascii_digit());
    column.rsplit_once('_').filter(|(_, ending)| is_number(ending)).map_or(column, |(name, _)| name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn column_of_custom_code_has_logged_unit_whatever_its_suffix() {
        assert_eq!(Scale::for_column("upload-bytes", None), Scale::Bytes);
        assert_eq!(Scale::for_column("crop-bytes", None), Scale::AsMeasured, "no unit was logged");
        assert_eq!(Scale::for_column("crop-bytes", Some("B")), Scale::Bytes);
    }

    #[test]
    fn nested_node_with_name_of_stage_has_logged_unit() {
        assert_eq!(
            Scale::for_column("inference_queue", None),
            Scale::AsMeasured,
            "the value may be the length of a queue"
        );
        assert_eq!(Scale::for_column("inference_queue", Some("s")), Scale::Milliseconds);
        assert_eq!(Scale::for_column("upload_2", Some("B")), Scale::Bytes);
        for column in ["queue", "upload_2", "capture_capture-ipc"] {
            assert_eq!(Scale::for_column(column, None), Scale::Milliseconds, "{column}");
        }
    }
}
