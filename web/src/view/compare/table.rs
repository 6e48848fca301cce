//! Table with a row for each configuration, and table of the differences between two configurations.

use peernet_analysis::accuracy::{ACCURACIES, ACCURACY_TITLES};
use peernet_analysis::compare::{Difference, LATENCIES};
use peernet_analysis::quality::Quality;
use peernet_analysis::total_column::TotalColumn;
use peernet_logger::stage;
use peernet_statistics::number::{
    NONE, bytes, column_decimals, count, duration, fixed_mean_std_ms, fixed_ms, percent,
};
use peernet_store::QuantityStatistics;

use super::{Comparison, Configuration, Differences, StageDifference, qualities};
use crate::look;
use crate::view::accuracy;
use crate::view::pipeline_table::Cell;

/// Returns the title of a stage or a total.
fn title(name: &str) -> &str {
    let sum = TotalColumn::SumOfStages;
    if name == sum.name() { sum.description() } else { look::label(name) }
}

/// Table with a row for each configuration.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Table {
    pub header: Header,
    pub rows: Vec<Row>,
}

/// The names of the columns.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Header {
    pub axes: Vec<String>,
    pub columns: Vec<&'static str>,
    /// Title of each quality, and its unit.
    pub qualities: Vec<(&'static str, &'static str)>,
    /// `true` if a configuration sends payloads, so that there is a column with their size.
    pub has_uploads: bool,
    /// `true` if a run has a deadline, so that there is a column with the miss rates.
    pub has_deadlines: bool,
}

/// One configuration. Times in ms.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Row {
    /// Value on each axis, or the name of the configuration if there is no axis.
    pub values: Vec<String>,
    /// Numbers of its runs.
    pub runs: Vec<i64>,
    pub iterations: String,
    /// Mean and standard deviation in each column.
    pub cells: Vec<(String, Option<String>)>,
    /// Estimate of each quality and its interval.
    pub qualities: Vec<(String, Option<String>)>,
    /// Mean size of the payloads sent up, with its unit.
    pub sent: String,
    /// Miss rate, percent. The tooltip has the counts from which the rate is computed.
    pub missed: Cell,
    /// `true` for the best configuration of the ranking.
    pub is_best: bool,
}

impl Table {
    pub(crate) fn of(comparison: &Comparison, differences: &Differences) -> Self {
        let is_measured =
            |name: &str| comparison.configurations.iter().any(|one| one.statistics(name).is_some());
        let columns = LATENCIES.into_iter().filter(|name| is_measured(name));
        let columns: Vec<_> = columns.map(|name| (name, comparison.mean_decimals(name))).collect();
        let is_known =
            |column: &QualityColumn| comparison.configurations.iter().any(|one| column.cell(one).is_some());
        let quality_columns: Vec<QualityColumn> = QualityColumn::all().filter(is_known).collect();
        let best = differences.ranking.as_ref().map(|ranking| ranking.best);
        let has_axes = !comparison.axes.is_empty();
        let row = |(index, one): (usize, &Configuration)| Row {
            values: if has_axes { one.values.clone() } else { vec![one.name.clone()] },
            runs: one.runs.iter().map(|run| run.number).collect(),
            iterations: count(one.iterations()),
            cells: columns
                .iter()
                .map(|(name, decimals)| match one.statistics(name) {
                    Some(QuantityStatistics { mean, std, .. }) => fixed_mean_std_ms(*mean, *std, *decimals),
                    None => (NONE.to_owned(), None),
                })
                .collect(),
            qualities: quality_columns
                .iter()
                .map(|column| column.cell(one).unwrap_or_else(|| (NONE.to_owned(), None)))
                .collect(),
            sent: one
                .statistics(&stage::UPLOAD_BYTES)
                .map_or_else(|| NONE.to_owned(), |sent| bytes(sent.mean).to_string()),
            missed: miss_rate_cell(one),
            is_best: best == Some(index),
        };
        Self {
            rows: comparison.configurations.iter().enumerate().map(row).collect(),
            header: Header {
                axes: if has_axes { comparison.axes.clone() } else { vec![String::new()] },
                columns: columns.into_iter().map(|(name, _)| title(name)).collect(),
                qualities: quality_columns.iter().map(QualityColumn::title).collect(),
                has_uploads: is_measured(&stage::UPLOAD_BYTES),
                has_deadlines: comparison.configurations.iter().any(|one| one.misses().is_some()),
            },
        }
    }
}

/// Column of a quality.
enum QualityColumn {
    Quality(Quality),
    /// Share of the answers whose five best classes contain the right class: index 1 of [`ACCURACIES`].
    Top5,
}

impl QualityColumn {
    /// Returns all columns in their order.
    fn all() -> impl Iterator<Item = Self> {
        let after_top_1 = |quality: &Quality| (*quality == Quality::Top1).then_some(Self::Top5);
        Quality::ALL.into_iter().flat_map(move |quality| {
            let next = after_top_1(&quality);
            std::iter::once(Self::Quality(quality)).chain(next)
        })
    }

    /// Returns the title and the unit.
    const fn title(&self) -> (&'static str, &'static str) {
        match self {
            Self::Quality(quality) => quality.title(),
            Self::Top5 => (ACCURACY_TITLES[1], "%"),
        }
    }

    /// Returns the estimate of a configuration and its interval; `None` if it was not measured.
    fn cell(&self, configuration: &Configuration) -> Option<(String, Option<String>)> {
        match self {
            Self::Quality(quality) => {
                Some(qualities::texts(*quality, &qualities::estimate(configuration, *quality)?))
            }
            Self::Top5 => {
                let (share, interval) = accuracy::texts(configuration.statistics(ACCURACIES[1])?)?;
                Some((share, Some(interval)))
            }
        }
    }
}

/// Returns the miss rate of a configuration.
fn miss_rate_cell(configuration: &Configuration) -> Cell {
    let Some(misses) = configuration.misses() else { return Cell::none("no deadline") };
    let Some(rate) = misses.rate() else { return Cell::none("no iteration") };
    let deadline = match configuration.deadline_s() {
        Some(deadline) => format!("longer than {}", duration(deadline)),
        None => "longer than the deadline of their run".to_owned(),
    };
    let explanation =
        format!("{} of {} iterations, {deadline} or failed", count(misses.missed), count(misses.iterations));
    Cell { text: percent(rate), title: Some(explanation) }
}

/// Returns the number of decimals of all differences between two configurations, ms.
pub(super) fn difference_decimals(stages: &[StageDifference]) -> usize {
    column_decimals(stages.iter().filter_map(|stage| stage.mean_difference).map(Difference::margin))
}

/// The difference of one stage between two configurations, as a row of a table. Times in ms.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct DifferenceRow {
    pub name: String,
    pub look: &'static str,
    pub baseline_mean: String,
    pub other_mean: String,
    /// Mean of the other configuration minus mean of the baseline; a dash if only one configuration has the stage.
    pub difference: String,
    /// 95 % interval of the difference; `None` if it is unknown.
    pub interval: Option<String>,
    /// `true` if the difference is larger than chance explains; `None` if that cannot be determined.
    pub is_distinct: Option<bool>,
}

impl DifferenceRow {
    /// Returns a row for each stage. All differences have the same number of decimals.
    pub(crate) fn of_stages(stages: &[StageDifference]) -> Vec<Self> {
        let decimals = difference_decimals(stages);
        stages.iter().map(|stage| Self::new(stage, decimals)).collect()
    }

    fn new(stage: &StageDifference, decimals: usize) -> Self {
        let ms = |mean: f64| fixed_ms(mean, decimals);
        let mean = |mean: Option<f64>| mean.map_or_else(|| NONE.to_owned(), ms);
        let texts = stage.mean_difference.map(|difference| difference.texts(decimals));
        let (difference, interval) = texts.unwrap_or_else(|| (NONE.to_owned(), None));
        Self {
            name: title(&stage.name).to_owned(),
            look: look::class(&stage.name),
            baseline_mean: mean(stage.means.0),
            other_mean: mean(stage.means.1),
            difference,
            interval,
            is_distinct: stage.is_distinct(),
        }
    }
}
