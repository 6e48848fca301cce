//! Table of runs that measure only a sensor.

use peernet_analysis::loaded::Loaded;
use peernet_analysis::sensor_study::SensorStudy;
use peernet_analysis::table::Table;
use peernet_statistics::number::{NONE as NO_VALUE, count, milliseconds, rate};

use super::plan::{Plan, Run};

const NOTE: &str = "Milliseconds. Period: from one sample to the next, mean ± standard deviation. Jitter: how far a period \
                    is from the median period. Sensing: from asking for a sample to having it, the median.";
const UNNUMBERED: &str = " A sensor that does not number its samples cannot tell how many it dropped (—).";

/// Table with a row for each edge that measured only a sensor.
pub(super) struct SensorsTable {
    table: Table,
    note: String,
    /// `true` if the table has a row for each edge of each run.
    pub(super) covers_all_runs: bool,
}

impl SensorsTable {
    /// Makes the table of the edges that measured only a sensor; `None` if there are none.
    pub(super) fn from_runs(plan: &Plan, runs: &[&Run], loaded: &[Vec<Loaded>]) -> Option<Self> {
        let edges: Vec<(&Run, &Loaded)> =
            runs.iter().zip(loaded).flat_map(|(run, users)| users.iter().map(|edge| (*run, edge))).collect();
        let sensor_only: Vec<(&Run, &Loaded, SensorStudy)> = edges
            .iter()
            .filter(|(_, edge)| edge.record.is_sensor_only())
            .filter_map(|(run, edge)| Some((*run, *edge, SensorStudy::from_rows(&edge.rows)?)))
            .collect();
        let (first, ..) = sensor_only.first()?;
        let (has_repeats, has_several_edges) = (plan.repeats > 1, loaded.iter().any(|users| users.len() > 1));
        let axes = plan.configuration(first).labels.iter().map(|(axis, _)| axis.clone());
        let mut header: Vec<String> = axes.collect();
        header.extend(has_repeats.then(|| "repeat".to_owned()));
        header.extend(has_several_edges.then(|| "edge".to_owned()));
        let label_columns = header.len();
        let metrics = ["samples", "rate /s", "period", "jitter p50", "jitter p99", "longest gap", "sensing"];
        header.extend(metrics.into_iter().chain(["dropped", "failed"]).map(str::to_owned));
        let row = |(run, edge, study): &(&Run, &Loaded, SensorStudy)| {
            let mut cells: Vec<String> =
                plan.configuration(run).labels.iter().map(|(_, label)| label.clone()).collect();
            cells.extend(has_repeats.then(|| (run.repeat + 1).to_string()));
            cells.extend(has_several_edges.then(|| edge.record.edge.name.clone()));
            cells.extend(sensor_metrics(study));
            cells
        };
        let unnumbered = sensor_only.iter().any(|(_, _, study)| study.dropped.is_none());
        Some(Self {
            table: Table { header, label_columns, rows: sensor_only.iter().map(row).collect(), marked: None },
            note: format!("{NOTE}{}", if unnumbered { UNNUMBERED } else { "" }),
            covers_all_runs: sensor_only.len() == edges.len(),
        })
    }

    /// Returns the table for the terminal.
    pub(super) fn text(&self) -> String {
        format!("{}\n\n{}", self.table.text().trim_end(), self.note)
    }

    /// Returns the table for documents.
    pub(super) fn markdown(&self) -> String {
        format!("{}\n{}\n", self.table.markdown(), self.note)
    }

    /// Returns the table for papers, with booktabs.
    pub(super) fn latex(&self) -> String {
        self.table.latex(&self.note)
    }
}

fn sensor_metrics(study: &SensorStudy) -> [String; 9] {
    let std = study.period_std.map_or_else(String::new, |std| format!(" ± {}", milliseconds(std)));
    [
        count(study.samples),
        rate(study.rate),
        format!("{}{std}", milliseconds(study.period)),
        milliseconds(study.jitter_median),
        study.jitter_p99.map_or_else(|| NO_VALUE.to_owned(), milliseconds),
        milliseconds(study.longest_gap),
        milliseconds(study.sensing),
        study.dropped.map_or_else(|| NO_VALUE.to_owned(), count),
        count(study.failed),
    ]
}
