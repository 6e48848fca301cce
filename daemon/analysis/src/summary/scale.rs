//! Scale in which the numbers of a column are shown.

use peernet_logger::Unit;

/// Nodes whose values are times, wherever they are in the tree. Their columns are times in files of any program.
const DURATION_COLUMNS: [&str; 19] = [
    "sensing",
    "upload",
    "preprocessing",
    "inference",
    "postprocessing",
    "download",
    "capture",
    "transform",
    "encode",
    "send-queue",
    "queue",
    "batch-wait",
    "ipc",
    "capture-ipc",
    "restart",
    "capture-restart",
    "actuation-ipc",
    "actuation-restart",
    "actuation",
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
    /// Returns the scale of a column. The scale of a standard column follows from its name, the scale of another column from the unit that
    /// was logged with its values.
    pub fn for_column(column: &str, unit: Option<&str>) -> Self {
        let is_total = ["lateness", "total", "stages-total", "unattributed"].contains(&column);
        let logged_in = |logged_unit: &Unit| unit == Some(logged_unit.symbol());
        match column {
            _ if is_total || DURATION_COLUMNS.contains(&node_name(column)) => Self::Milliseconds,
            "upload-throughput" | "download-throughput" => Self::MegabytesPerSecond,
            _ if column.ends_with("-bytes") => Self::Bytes,
            _ if logged_in(&Unit::SECONDS) => Self::Milliseconds,
            _ if logged_in(&Unit::BITS_PER_SECOND) => Self::MegabytesPerSecond,
            _ if logged_in(&Unit::BYTES) => Self::Bytes,
            _ => Self::AsMeasured,
        }
    }
}

/// Returns the name of the node that a column belongs to, without the names of its parents and without an appended number.
fn node_name(column: &str) -> &str {
    let column = column.strip_suffix(VALUE_SUFFIX).unwrap_or(column);
    let is_number = |last: &str| last.bytes().all(|byte| byte.is_ascii_digit());
    let column =
        column.rsplit_once('_').filter(|(_, last)| is_number(last)).map_or(column, |(front, _)| front);
    column.rsplit_once('_').map_or(column, |(_, last)| last)
}
