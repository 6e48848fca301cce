//! Figure of a model's latency on the robot and in the cloud.

use peernet_statistics::number::counted;

use super::columns::{heading, undrawn_rows_note, unit, values};
use super::missing_data::MissingData;
use super::replayed::{is_replayed, marked};
use super::written_figures::{AnyFigure, Drawing};
use crate::drawing::{Group, MAX_GROUPS, MAX_PLACEMENTS, Paired};
use peernet_analysis::loaded::Loaded;
use peernet_analysis::model_places::{ModelPlaces, PlacedModel};
use peernet_analysis::order::SortedValues;
use peernet_analysis::record::RunRecord;

/// Returns the figure of the models that ran at several placements. `column` is the column of the latency; `None`
/// stands for `inference`.
pub(super) fn drawings(runs: &[Loaded], column: Option<&str>) -> Result<Vec<Drawing>, MissingData> {
    let column = column.unwrap_or("inference");
    let runs_with_values: Vec<&Loaded> =
        runs.iter().filter(|run| !values(&run.rows, column).is_empty()).collect();
    let placed_models: Vec<PlacedModel> =
        runs_with_values.iter().map(|run| placed_model(&run.record)).collect();
    let ModelPlaces { places: placements, models, at_one_place } = ModelPlaces::new(&placed_models);
    if models.is_empty() {
        return Err(MissingData::SecondPlacement { column: column.to_owned() });
    }
    if placements.len() > MAX_PLACEMENTS || models.len() > MAX_GROUPS {
        return Err(MissingData::TooManyModels { models: models.len(), placements: placements.len() });
    }
    let values_of = |runs: &Vec<usize>| -> SortedValues {
        let values =
            runs.iter().flat_map(|run| values(&runs_with_values[*run].rows, column).values().to_vec());
        values.collect()
    };
    let is_run_replayed = |run: &usize| is_replayed(&runs_with_values[*run].record);
    let runs_at_placement = |placement: usize| models.iter().flat_map(move |(_, runs)| &runs[placement]);
    // If all latencies at a placement are replayed, the name of the placement is marked. Otherwise, the names of the
    // models that have replayed latencies at the placement are marked.
    let replayed_placements: Vec<bool> = (0..placements.len())
        .map(|placement| {
            runs_at_placement(placement).next().is_some() && runs_at_placement(placement).all(is_run_replayed)
        })
        .collect();
    let group = |(name, runs): &(String, Vec<Vec<usize>>)| Group {
        name: marked(
            name,
            runs.iter()
                .zip(&replayed_placements)
                .any(|(runs, is_placement_marked)| !is_placement_marked && runs.iter().any(is_run_replayed)),
        ),
        values: runs.iter().map(values_of).collect(),
    };
    let placement_names = placements
        .iter()
        .zip(&replayed_placements)
        .map(|(name, is_replayed)| marked(name, *is_replayed))
        .collect();
    let groups: Vec<Group> = models.iter().map(group).collect();
    let mut left_out = Vec::new();
    if !at_one_place.is_empty() {
        left_out.push(format!("left out, at one placement only: {}", at_one_place.join(", ")));
    }
    let omitted_runs = runs.len() - runs_with_values.len();
    if omitted_runs > 0 {
        left_out.push(format!("left out: {} without {column}", counted(omitted_runs as u64, "run")));
    }
    let shown_runs = models.iter().flat_map(|(_, runs)| runs.iter().flatten());
    let rows = shown_runs.flat_map(|run| &runs_with_values[*run].rows);
    let value_count = groups.iter().flat_map(|group| &group.values).map(SortedValues::len).sum();
    let undrawn_text = undrawn_rows_note(&rows, value_count).map(|note| format!("{note} · "));
    let reading_note = format!("{}black: median, bar: middle half", undrawn_text.unwrap_or_default());
    let quantity = heading(column);
    let paired = Paired {
        title: format!("{quantity} by model"),
        unit: unit(&runs_with_values[0].record.units, column, &quantity),
        placements: placement_names,
        groups,
        notes: std::iter::once(reading_note).chain(left_out.iter().cloned()).collect(),
    };
    Ok(vec![Drawing::new("paired", AnyFigure::Paired(paired)).with_left_out(left_out)])
}

/// Returns the model of a run and where it ran. For a run without a model, the name of the run takes the place of the
/// model's name.
fn placed_model(record: &RunRecord) -> PlacedModel {
    let model = record.model.as_ref();
    PlacedModel {
        model: model.map_or_else(|| record.name.clone(), |model| model.name.clone()),
        kind: record.placement.kind.clone(),
        device: model.and_then(|model| model.device.clone()).unwrap_or_default(),
    }
}
