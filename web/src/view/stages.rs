//! The table of stages, live or stored.

use peernet_aggregator::Window;
use peernet_analysis::stage_split::share_of_total;
use peernet_figures::drawing::{StagePart, share_bar};
use peernet_logger::stage;
use peernet_statistics::number::{self, DurationFormat, EXACT, NONE, bound_ms};
use peernet_store::{DelayAccuracy, QuantityStatistics, SENSING_CHILDREN, StageStatistics, table_order};

use super::chip::{Chip, Sign};
use super::clocks;
use super::stack::Stack;
use crate::look;
use crate::picture::Picture;

/// Row of a stage. Times in ms.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct StageRow {
    pub name: String,
    /// CSS class of the stage's colour.
    pub look: &'static str,
    /// 1 for a part of another row, such as `capture` of `sensing`; else 0.
    pub depth: u8,
    /// Number of iterations that have the stage, as `50 of 100`, where not every iteration has it. The statistics in
    /// the row are over these iterations.
    pub occurrence: Option<String>,
    pub mean: String,
    pub std: Option<String>,
    pub p50: String,
    pub p95: String,
    pub p99: String,
    pub max: String,
    pub bound: BoundCell,
    /// Bar that shows the share of the stage in the total.
    pub share: Option<Picture>,
    /// `true` for the row of the total.
    pub is_total: bool,
}

/// The clock bound of a stage.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct BoundCell {
    pub text: String,
    /// Icon of the verdict on the delays; `None` without delays.
    pub sign: Option<Sign>,
    pub title: &'static str,
}

/// Reason why a quantile is missing. The numbers are `MIN_VALUES_FOR_P95` and `MIN_VALUES_FOR_P99`.
pub(crate) const TOO_FEW: &str = "too few iterations: p95 needs 60, p99 needs 300";

impl StageRow {
    fn new(
        format: DurationFormat,
        name: &str,
        statistics: Option<&QuantityStatistics>,
        bound: Option<&DelayAccuracy>,
        share: Option<f64>,
    ) -> Self {
        let text = |number_of: fn(&QuantityStatistics) -> Option<f64>| {
            statistics.and_then(number_of).map_or_else(|| NONE.to_owned(), |value| format.duration(value))
        };
        Self {
            look: look::class(name),
            depth: u8::from(name == look::LATENESS || SENSING_CHILDREN.contains(&name)),
            occurrence: None,
            mean: text(|statistics| Some(statistics.mean)),
            std: statistics.and_then(|statistics| statistics.std).map(|std| format.number(std)),
            p50: text(|statistics| Some(statistics.p50)),
            p95: text(|statistics| statistics.p95),
            p99: text(|statistics| statistics.p99),
            max: text(|statistics| Some(statistics.max)),
            bound: BoundCell::of(name, bound),
            share: share.map(|share| {
                let class = if name == "total" { "sharebar full" } else { "sharebar" };
                Picture::of_items(&share_bar(name, share), class, &number::share(share))
            }),
            is_total: name == "total",
            name: name.to_owned(),
        }
    }

    /// Returns whether the stage has values, and therefore a distribution that the row can link to.
    pub(crate) fn is_measured(&self) -> bool {
        self.p50 != NONE
    }

    /// Adds the number of iterations to the rows of stages that not every iteration has. `count_of` returns the number
    /// of values of a stage.
    fn with_occurrences(mut rows: Vec<Self>, count_of: impl Fn(&str) -> Option<u64>) -> Vec<Self> {
        let iterations = count_of("total").unwrap_or(0);
        for row in &mut rows {
            let values = count_of(&row.name).filter(|values| *values < iterations);
            row.occurrence =
                values.map(|values| format!("{} of {}", number::count(values), number::count(iterations)));
        }
        rows
    }

    /// Returns the row of the sum of both directions.
    fn network(format: DurationFormat, part: &StagePart, share: Option<f64>) -> Self {
        let (statistics, bound) = (None, None);
        let title = "independent of the clock offset: the round trip on the edge minus the time on the cloud";
        Self {
            mean: format.duration(part.seconds),
            bound: BoundCell { text: EXACT.to_owned(), sign: None, title },
            ..Self::new(format, &part.name, statistics, bound, share)
        }
    }

    /// Returns the rows of a stored run: the stages, the unattributed time, the lateness, the total.
    pub(crate) fn of_run(stages: &[StageStatistics], bounds: &[DelayAccuracy]) -> Vec<Self> {
        let is_listed_first = |stage: &&StageStatistics| {
            stage.unit == "s"
                && stage.stage != "stages-total"
                && stage.stage != "total"
                && stage.stage != "unattributed"
                && stage.stage != look::LATENESS
        };
        let stack = Stack::of_run(stages, bounds);
        let format = stack.duration_format();
        let mut rows: Vec<Self> = stages
            .iter()
            .filter(is_listed_first)
            .map(|stage| {
                Self::new(format, &stage.stage, Some(&stage.statistics), stage.bound.as_ref(), stage.share)
            })
            .collect();
        let index_of = |rows: &[Self], name: &str| {
            rows.partition_point(|row| table_order(&row.name) < table_order(name))
        };
        // A direction without a known delay has no statistics, and therefore no row yet. Its row shows the verdict on
        // the delays.
        for bound in bounds.iter().filter(|bound| stages.iter().all(|stage| stage.stage != bound.stage)) {
            let (statistics, share) = (None, None);
            let row = Self::new(format, &bound.stage, statistics, Some(bound), share);
            rows.insert(index_of(&rows, &bound.stage), row);
        }
        // Only if neither direction has a known delay, the sum of both directions has a row, before `upload` as in the
        // bar.
        if let Some(network) = stack.parts.iter().find(|part| part.name == look::NETWORK) {
            let share = stack.split.share_of_mean_total(network.seconds);
            let row = Self::network(format, network, Some(share));
            rows.insert(index_of(&rows, &stage::UPLOAD), row);
        }
        let has = |name: &str| stages.iter().any(|stage| stage.stage == *name);
        rows.extend(
            ["unattributed", look::LATENESS, "total"].into_iter().filter(|name| has(name)).filter_map(
                |name| {
                    let stage = stages.iter().find(|stage| stage.stage == *name)?;
                    Some(Self::new(
                        format,
                        name,
                        Some(&stage.statistics),
                        None,
                        stage.share.or((name == "total").then_some(1.0)),
                    ))
                },
            ),
        );
        Self::with_occurrences(rows, |name| {
            stages.iter().find(|stage| stage.stage == *name).map(|stage| stage.statistics.count)
        })
    }

    /// Returns the rows of a live window.
    pub(crate) fn of_window(window: &Window) -> Vec<Self> {
        let stack = Stack::of_window(window);
        let format = stack.duration_format();
        let count_and_mean_of =
            |name: &str| window.value(name).map(|statistics| (statistics.count, statistics.mean));
        let sent = DelayAccuracy::sent_messages(&window.bounds);
        let share = |name: &str| share_of_total(name, sent, count_and_mean_of);
        let mut rows = Vec::new();
        let network = stack.parts.iter().find(|part| part.name == look::NETWORK);
        // `sensing` is the first of `parts`. Its children follow it.
        let order = look::parts().take(1).chain(SENSING_CHILDREN).chain(look::parts().skip(1));
        // Lateness is a part of the unattributed time, so its row follows that row.
        let order = order.filter(|name| *name != look::LATENESS).chain([look::LATENESS, "total"]);
        for name in order {
            if let Some(network) = network.filter(|_| name == look::NETWORK) {
                rows.push(Self::network(format, network, share(look::NETWORK)));
            }
            let bound = window.bounds.iter().find(|bound| bound.stage == *name);
            let statistics = window.value(name);
            if statistics.is_some() || bound.is_some_and(|bound| !bound.verdicts.is_empty()) {
                rows.push(Self::new(format, name, statistics, bound, share(name)));
            }
        }
        Self::with_occurrences(rows, |name| window.value(name).map(|statistics| statistics.count))
    }
}

impl BoundCell {
    fn of(name: &str, bound: Option<&DelayAccuracy>) -> Self {
        let (Some(bound), true) = (bound, stage::is_one_way(name)) else {
            return Self {
                text: NONE.to_owned(),
                sign: None,
                title: "start and end are read from the same clock",
            };
        };
        let verdict = clocks::verdict(bound);
        Self {
            text: bound.median_half_width().map_or_else(|| NONE.to_owned(), bound_ms),
            sign: verdict.map(|verdict| Chip::verdict(verdict).into()),
            title: verdict.map_or("no delays in this time", clocks::meaning),
        }
    }
}

/// Returns name and verdict of each direction in which messages were sent.
pub(crate) fn directions(bounds: &[DelayAccuracy]) -> Vec<(String, Chip)> {
    let verdicts = bounds.iter().filter_map(|bound| Some((bound, clocks::verdict(bound)?)));
    verdicts.map(|(bound, verdict)| (bound.stage.to_string(), Chip::verdict(verdict))).collect()
}

#[cfg(test)]
mod tests {
    use peernet_clock::Verdict;
    use peernet_logger::Name;

    use super::*;
    use crate::tests::samples;

    #[test]
    fn tables_and_bar_have_one_order() {
        let window = samples::window(60, 5.0, 1.0, Verdict::Unsynchronised);
        let stage = |(name, statistics): &(Name, QuantityStatistics)| StageStatistics {
            stage: name.clone(),
            unit: "s".to_owned(),
            is_stage: stage::ORDER.contains(name),
            statistics: *statistics,
            share: None,
            bound: None,
        };
        let stages: Vec<StageStatistics> = window.values.iter().map(stage).collect();
        let parts: Vec<String> = Stack::of_window(&window).parts.into_iter().map(|part| part.name).collect();
        assert_eq!(parts[..3], ["sensing", "encode", look::NETWORK]);
        for rows in [StageRow::of_window(&window), StageRow::of_run(&stages, &window.bounds)] {
            let names = rows.into_iter().map(|row| row.name).filter(|name| parts.contains(name));
            assert_eq!(names.collect::<Vec<_>>(), parts);
        }
    }
}
