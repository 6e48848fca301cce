//! Figure of a model's latency on the robot and in the cloud.

use peernet_statistics::number::counted;
use peernet_stream::PlacementKind;

use super::columns::{excluded_and_undrawn_note, heading, unit, values};
use super::missing_data::MissingData;
use super::written_figures::{AnyFigure, Drawing};
use crate::drawing::{Group, MOST_GROUPS, MOST_SIDES, Paired};
use peernet_analysis::loaded::Loaded;
use peernet_analysis::order::SortedValues;
use peernet_analysis::record::RunRecord;

/// Returns the figure of the models, each at its placements. There must be at least two placements.
pub(super) fn drawings(runs: &[Loaded], column: Option<&str>) -> Result<Vec<Drawing>, MissingData> {
    let column = column.unwrap_or("inference");
    let runs_with_values: Vec<&Loaded> =
        runs.iter().filter(|run| !values(&run.rows, column).is_empty()).collect();
    let models = deduplicate(runs_with_values.iter().map(|run| model_name(&run.record)));
    let mut sides = deduplicate(runs_with_values.iter().map(|run| placement_and_device(&run.record)));
    // The local placement is the first side.
    sides.sort_by_key(|(kind, _)| kind != PlacementKind::Local.name());
    if sides.len() < 2 {
        return Err(MissingData::SecondPlace { column: column.to_owned() });
    }
    if sides.len() > MOST_SIDES || models.len() > MOST_GROUPS {
        return Err(MissingData::TooManyModels { models: models.len(), places: sides.len() });
    }
    let values_at = |model: &String, side: &(String, String)| -> SortedValues {
        let matching_runs = runs_with_values
            .iter()
            .filter(|run| model_name(&run.record) == *model && placement_and_device(&run.record) == *side);
        matching_runs.flat_map(|run| values(&run.rows, column).values().to_vec()).collect()
    };
    let group = |model: &String| Group {
        name: model.clone(),
        values: sides.iter().map(|side| values_at(model, side)).collect(),
    };
    let mut groups: Vec<Group> = models.iter().map(group).collect();
    let is_paired = |group: &Group| group.values.iter().filter(|values| !values.is_empty()).count() > 1;
    let mut missing = Vec::new();
    // A model with a single placement compares nothing, so such models are only shown if no model ran at two placements.
    if groups.iter().any(is_paired) {
        let (paired, unpaired): (Vec<Group>, Vec<Group>) = groups.into_iter().partition(is_paired);
        groups = paired;
        if !unpaired.is_empty() {
            let names: Vec<&str> = unpaired.iter().map(|group| group.name.as_str()).collect();
            missing.push(format!("left out, at one placement only: {}", names.join(", ")));
        }
    }
    let omitted_runs = runs.len() - runs_with_values.len();
    if omitted_runs > 0 {
        missing.push(format!("left out: {} without {column}", counted(omitted_runs as u64, "run")));
    }
    let rows = runs_with_values
        .iter()
        .filter(|run| groups.iter().any(|group| group.name == model_name(&run.record)))
        .flat_map(|run| &run.rows);
    let count = groups.iter().flat_map(|group| &group.values).map(SortedValues::len).sum();
    let left_out = excluded_and_undrawn_note(&rows, count).map(|left_out| format!("{left_out} · "));
    let reading_note = format!("{}black: median, bar: middle half", left_out.unwrap_or_default());
    let quantity = heading(column);
    let paired = Paired {
        title: format!("{quantity} by model"),
        unit: unit(&runs_with_values[0].record.units, column, &quantity),
        sides: side_names(&sides),
        groups,
        notes: std::iter::once(reading_note).chain(missing.iter().cloned()).collect(),
    };
    Ok(vec![Drawing::new("paired", AnyFigure::Paired(paired)).with_left_out(missing)])
}

/// Returns the name of the run's model, or the name of a run without a model.
fn model_name(record: &RunRecord) -> String {
    record.model.as_ref().map_or_else(|| record.name.clone(), |model| model.name.clone())
}

/// Returns the kind of placement and the device of a run. A run whose placement is not known counts as remote.
fn placement_and_device(record: &RunRecord) -> (String, String) {
    let device = record.model.as_ref().and_then(|model| model.device.clone()).unwrap_or_default();
    let kind = record.placement.kind.as_str();
    let kind = if kind.is_empty() { PlacementKind::Remote.name() } else { kind };
    (kind.to_owned(), device)
}

/// Returns the names of the sides: the kind of placement, followed by the device if several sides have this kind.
fn side_names(sides: &[(String, String)]) -> Vec<String> {
    let is_only_side = |kind: &str| sides.iter().filter(|(other, _)| other == kind).count() == 1;
    let name = |(kind, device): &(String, String)| {
        if is_only_side(kind) || device.is_empty() { kind.clone() } else { format!("{kind}, {device}") }
    };
    sides.iter().map(name).collect()
}

/// Returns the first of each group of equal items, in the same order.
fn deduplicate<T: PartialEq>(items: impl Iterator<Item = T>) -> Vec<T> {
    let mut distinct: Vec<T> = Vec::new();
    items.for_each(|item| {
        if !distinct.contains(&item) {
            distinct.push(item);
        }
    });
    distinct
}
