//! Names of the files in a result folder.

/// File of the rows.
pub const DATA: &str = "data.csv";
/// File of the record, with everything but the rows.
pub const RECORD: &str = "run.json";
/// File of the study of a run that measures only a sensor.
pub const SENSOR_STUDY: &str = "sensor.txt";
/// Files of the summary.
pub(crate) const SUMMARIES: [&str; 3] = ["summary.md", "summary.csv", "summary.tex"];
