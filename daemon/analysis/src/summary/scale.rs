//! Scale in which the numbers of a column are shown.

use peernet_logger::Unit;

/// Columns that are times, wherever their nodes are in the tree, and in the files of any program.
const DURATION_COLUMNS: [&str; 18] = [
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
    "ipc",
    "capture-ipc",
    "restart",
    "capture-restart",
    "actuation-ipc",
    "actuation-restart",
    "actuation",
];

/// Suffix of a further column that holds a node's own value and not the sum of its children.
const VALUE_SUFFIX: &str = "_val";

/// Form in which numbers of a column are shown.
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
    /// Returns the scale of a standard column by its name, and of another one by the unit that it was logged with.
    pub fn for_column(column: &str, unit: Option<&str>) -> Self {
        let total = ["lateness", "total", "stages-total", "unattributed"].contains(&column);
        let logged_in = |known: &Unit| unit == Some(known.symbol());
        match column {
            _ if total || DURATION_COLUMNS.contains(&node_name(column)) => Self::Milliseconds,
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
    let number = |last: &str| last.bytes().all(|byte| byte.is_ascii_digit());
    let column = column.rsplit_once('_').filter(|(_, last)| number(last)).map_or(column, |(front, _)| front);
    column.rsplit_once('_').map_or(column, |(_, last)| last)
}
