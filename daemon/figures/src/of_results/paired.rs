//! Figure of a model's latency on the robot and in the cloud.

use peernet_statistics::number::counted;

use super::columns::{excluded_and_undrawn_note, heading, unit, values};
use super::missing_data::MissingData;
use super::replayed::{is_replayed, marked};
use super::written_figures::{AnyFigure, Drawing};
use crate::drawing::{Group, MAX_GROUPS, MAX_PLACEMENTS, Paired};
use peernet_analysis::loaded::Loaded;
use peernet_analysis::model_places::{ModelPlaces, PlacedModel};
use peernet_analysis::order::SortedValues;
use peernet_analysis::record::RunRecord;

/// Returns the figure of the models that ran at several placements. It is an error if there is no such model.
pub(super) fn drawings(runs: &[Loaded], column: Option<&str>) -> Result<Vec<Drawing>, MissingData> {
    let column = column.unwrap_or("inference");
    let runs_with_values: Vec<&Loaded> =
        runs.iter().filter(|run| !values(&run.rows, column).is_empty()).collect();
    let placed_models: Vec<PlacedModel> =
        runs_with_values.iter().map(|run| placed_model(&run.record)).collect();
    let ModelPlaces { places: sides, models, at_one_place } = ModelPlaces::new(&placed_models);
    if models.is_empty() {
        return Err(MissingData::SecondPlacement { column: column.to_owned() });
    }
    if sides.len() > MAX_PLACEMENTS || models.len() > MAX_GROUPS {
        return Err(MissingData::TooManyModels { models: models.len(), placements: sides.len() });
    }
    let values_of = |runs: &Vec<usize>| -> SortedValues {
        let values =
            runs.iter().flat_map(|run| values(&runs_with_values[*run].rows, column).values().to_vec());
        values.collect()
    };
    let is_replayed = |run: &usize| is_replayed(&runs_with_values[*run].record);
    let runs_of_side = |side: usize| models.iter().flat_map(move |(_, places)| &places[side]);
    // If all latencies of a side are replayed, the name of the side is marked. Otherwise the names of its models with
    // replayed latencies are.
    let replayed_sides: Vec<bool> = (0..sides.len())
        .map(|side| runs_of_side(side).next().is_some() && runs_of_side(side).all(is_replayed))
        .collect();
    let group = |(name, runs): &(String, Vec<Vec<usize>>)| Group {
        name: marked(
            name,
            runs.iter().zip(&replayed_sides).any(|(runs, side)| !side && runs.iter().any(is_replayed)),
        ),
        values: runs.iter().map(values_of).collect(),
    };
    let sides =
        sides.iter().zip(&replayed_sides).map(|(side, is_replayed)| marked(side, *is_replayed)).collect();
    let groups: Vec<Group> = models.iter().map(group).collect();
    let mut missing = Vec::new();
    if !at_one_place.is_empty() {
        missing.push(format!("left out, at one placement only: {}", at_one_place.join(", ")));
    }
    let omitted_runs = runs.len() - runs_with_values.len();
    if omitted_runs > 0 {
        missing.push(format!("left out: {} without {column}", counted(omitted_runs as u64, "run")));
    }
    let shown_runs = models.iter().flat_map(|(_, places)| places.iter().flatten());
    let rows = shown_runs.flat_map(|run| &runs_with_values[*run].rows);
    let count = groups.iter().flat_map(|group| &group.values).map(SortedValues::len).sum();
    let left_out = excluded_and_undrawn_note(&rows, count).map(|left_out| format!("{left_out} · "));
    let reading_note = format!("{}black: median, bar: middle half", left_out.unwrap_or_default());
    let quantity = heading(column);
    let paired = Paired {
        title: format!("{quantity} by model"),
        unit: unit(&runs_with_values[0].record.units, column, &quantity),
        sides,
        groups,
        notes: std::iter::once(reading_note).chain(missing.iter().cloned()).collect(),
    };
    Ok(vec![Drawing::new("paired", AnyFigure::Paired(paired)).with_left_out(missing)])
}

/// Returns the model of a run and its place. A run without a model has the name of the run.
fn placed_model(record: &RunRecord) -> PlacedModel {
    let model = record.model.as_ref();
    PlacedModel {
        model: model.map_or_else(|| record.name.clone(), |model| model.name.clone()),
        kind: record.placement.kind.clone(),
        device: model.and_then(|model| model.device.clone()).unwrap_or_default(),
    }
}
