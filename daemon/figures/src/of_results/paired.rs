//! Figure of a model's latency on the robot and in the cloud.

use peernet_statistics::number::counted;
use peernet_stream::PlacementKind;

use super::columns::{excluded_and_undrawn_note, heading, unit, values};
use super::missing_data::MissingData;
use super::written::{Drawing, Shown};
use crate::drawing::{Group, MOST_GROUPS, MOST_SIDES, Paired};
use peernet_analysis::loaded::Loaded;
use peernet_analysis::order::SortedValues;
use peernet_analysis::record::RunRecord;

/// Returns the models with their placements, if there are two placements.
pub(super) fn drawings(runs: &[Loaded], column: Option<&str>) -> Result<Vec<Drawing>, MissingData> {
    let column = column.unwrap_or("inference");
    let shown: Vec<&Loaded> = runs.iter().filter(|run| !values(&run.rows, column).is_empty()).collect();
    let models = distinct(shown.iter().map(|run| model(&run.record)));
    let mut sides = distinct(shown.iter().map(|run| side(&run.record)));
    sides.sort_by_key(|(kind, _)| kind != PlacementKind::Local.name());
    if sides.len() < 2 {
        return Err(MissingData::SecondPlace { column: column.to_owned() });
    }
    if sides.len() > MOST_SIDES || models.len() > MOST_GROUPS {
        return Err(MissingData::TooManyModels { models: models.len(), places: sides.len() });
    }
    let of = |model_name: &String, place: &(String, String)| -> SortedValues {
        let here =
            shown.iter().filter(|run| model(&run.record) == *model_name && side(&run.record) == *place);
        here.flat_map(|run| values(&run.rows, column).values().to_vec()).collect()
    };
    let group = |name: &String| Group {
        name: name.clone(),
        values: sides.iter().map(|place| of(name, place)).collect(),
    };
    let mut groups: Vec<Group> = models.iter().map(group).collect();
    let is_paired = |group: &Group| group.values.iter().filter(|values| !values.is_empty()).count() > 1;
    let mut missing = Vec::new();
    // A model with a single placement compares nothing, so it is only shown if no model ran at two placements.
    if groups.iter().any(is_paired) {
        let (paired, alone): (Vec<Group>, Vec<Group>) = groups.into_iter().partition(is_paired);
        groups = paired;
        if !alone.is_empty() {
            let names: Vec<&str> = alone.iter().map(|group| group.name.as_str()).collect();
            missing.push(format!("left out, at one placement only: {}", names.join(", ")));
        }
    }
    let without = runs.len() - shown.len();
    if without > 0 {
        missing.push(format!("left out: {} without {column}", counted(without as u64, "run")));
    }
    let rows = shown
        .iter()
        .filter(|run| groups.iter().any(|group| group.name == model(&run.record)))
        .flat_map(|run| &run.rows);
    let count = groups.iter().flat_map(|group| &group.values).map(SortedValues::len).sum();
    let left_out = excluded_and_undrawn_note(&rows, count).map(|left_out| format!("{left_out} · "));
    let read = format!("{}black: median, bar: middle half", left_out.unwrap_or_default());
    let what = heading(column);
    let paired = Paired {
        title: format!("{what} by model"),
        unit: unit(&shown[0].record.units, column, &what),
        sides: names(&sides),
        groups,
        notes: std::iter::once(read).chain(missing.iter().cloned()).collect(),
    };
    Ok(vec![Drawing::new("paired", Shown::Paired(paired)).without(missing)])
}

fn model(record: &RunRecord) -> String {
    record.model.as_ref().map_or_else(|| record.name.clone(), |model| model.name.clone())
}

/// Returns the placement and the device of a run.
fn side(record: &RunRecord) -> (String, String) {
    let device = record.model.as_ref().and_then(|model| model.device.clone()).unwrap_or_default();
    let kind = record.placement.kind.as_str();
    let kind = if kind.is_empty() { PlacementKind::Remote.name() } else { kind };
    (kind.to_owned(), device)
}

/// Returns the names of the placements, with the device if the kind of placement does not distinguish them.
fn names(sides: &[(String, String)]) -> Vec<String> {
    let alone = |kind: &str| sides.iter().filter(|(other, _)| other == kind).count() == 1;
    let name = |(kind, device): &(String, String)| {
        if alone(kind) || device.is_empty() { kind.clone() } else { format!("{kind}, {device}") }
    };
    sides.iter().map(name).collect()
}

fn distinct<T: PartialEq>(all: impl Iterator<Item = T>) -> Vec<T> {
    let mut distinct: Vec<T> = Vec::new();
    all.for_each(|one| {
        if !distinct.contains(&one) {
            distinct.push(one);
        }
    });
    distinct
}
