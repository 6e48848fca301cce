//! Time for which the iterations of a run waited for restarts of processes.

use peernet_logger::{Name, stage};

use crate::rows::Rows;

/// Iterations in the statistics that waited for the restart of a process.
#[derive(Clone, Debug, PartialEq)]
pub struct Restarts {
    /// Owner of the process: `model`, `sensor` or `actuator`.
    pub owner: &'static str,
    /// Number of these iterations.
    pub count: u64,
    /// Total time that these iterations waited for restarts, seconds.
    pub seconds: f64,
    /// Iteration number of each of these iterations; empty if the numbers are not known.
    pub iterations: Vec<u64>,
}

impl Restarts {
    /// For each owner of a process: its name, the node with the time of a restart, and the column of this node in
    /// `data.csv`.
    pub const NODES: [(&'static str, Name, &'static str); 3] = [
        ("sensor", stage::CAPTURE_RESTART, "capture_capture-restart"),
        ("model", stage::RESTART, "restart"),
        ("actuator", stage::ACTUATION_RESTART, "actuation_actuation-restart"),
    ];

    pub(super) fn from_rows(rows: &Rows) -> Vec<Self> {
        let restarts_of = |(owner, _, column): (_, Name, &str)| {
            let affected_rows =
                rows.iter().filter(|row| row.is_in_statistics() && row.value(column).is_some());
            let iterations: Vec<u64> = affected_rows.map(|row| row.iteration()).collect();
            let (count, seconds) = (iterations.len() as u64, rows.values_in_statistics(column).sum());
            (count > 0).then_some(Self { owner, count, seconds, iterations })
        };
        Self::NODES.into_iter().filter_map(restarts_of).collect()
    }
}
