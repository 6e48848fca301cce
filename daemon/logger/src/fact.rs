//! Names of the facts of a run that analyses read.

/// Marks the latencies of a run as replayed. The text of the fact describes the distribution.
pub const REPLAYED: &str = "Replayed";
/// Says how many pictures have a label, with examples of the labels: `30 of 30: dented, good`.
pub const LABELS: &str = "Labels";
/// Gives the number of classes of the model and examples of them: `4: good, scratched, …`.
pub const CLASSES: &str = "Classes";
