//! Pictures of a comparison: stacks, pairs of local and cloud.

use peernet_figures::drawing::{Quartiles, StageBar, StagePart};
use peernet_figures::scale::Scale;
use peernet_logger::stage;
use peernet_statistics::number::{NONE, duration, mean_std_ms};
use peernet_stream::{Placement, PlacementKind};
use std::slice;

use super::spread::box_plot;
use super::{Comparison, Configuration, order};
use crate::picture::Picture;
use crate::view::place;
use crate::view::stack::Stack;

/// Maximum number of hosts of one configuration that are named.
const MAX_NAMED_HOSTS: usize = 4;

/// A configuration's stages as a bar.
pub(crate) struct StackRow {
    pub name: String,
    pub bar: Picture,
    pub total: (String, Option<String>),
    pub best: bool,
}

/// The labels of a scale: once above all bars, and on narrow screens under each bar.
pub(crate) struct Axes {
    pub above: Picture,
    pub under: Picture,
}

impl Axes {
    pub(super) fn of(scale: &Scale) -> Self {
        Self {
            above: Picture::milliseconds_axis(scale, ""),
            under: Picture::milliseconds_axis(scale, "small"),
        }
    }
}

/// One model, on board and in the cloud.
pub(crate) struct Pair {
    pub model: String,
    pub places: Vec<PlaceRow>,
}

/// Row of a model's host.
pub(crate) struct PlaceRow {
    /// Name of its configuration.
    pub configuration: String,
    /// Host of the model, and the hosts that it serves.
    pub place: String,
    pub inference: (String, Option<String>),
    pub spread: Picture,
}

/// Returns a bar of the mean stages of each configuration, all on one scale. The error bar is the standard deviation of the total.
pub(crate) fn stacks(comparison: &Comparison, best: Option<usize>) -> (Vec<StackRow>, Axes) {
    let all = &comparison.configurations;
    let reach = |one: &Configuration| one.total().map_or(0.0, |total| total.mean + total.std.unwrap_or(0.0));
    let scale = Scale::up_to(all.iter().map(reach).fold(0.0, f64::max) * 1e3, 6);
    let row = |(index, one): (usize, &Configuration)| {
        let parts = parts(one);
        let total = one.total();
        let spread = total.and_then(|total| Some((total.mean, total.std?)));
        let bar = StageBar { spread, ..StageBar::new(&parts, scale) };
        StackRow {
            name: one.name.clone(),
            total: total.map_or((NONE.to_owned(), None), |total| mean_std_ms(total.mean, total.std)),
            bar: Picture::of_items(&bar.items(), "stages", &label(one, &parts)),
            best: best == Some(index),
        }
    };
    (all.iter().enumerate().map(row).collect(), Axes::of(&scale))
}

/// Returns the means of the stages. For a pipeline that only senses, returns the mean of `sensing`.
fn parts(one: &Configuration) -> Vec<StagePart> {
    let mut parts = Stack::of_run(&one.stages, &one.bounds).parts;
    if parts.is_empty() {
        let sensing = one.figures(&stage::SENSING);
        parts.extend(sensing.map(|figures| StagePart {
            name: stage::SENSING.to_string(),
            seconds: figures.mean,
            bound: None,
        }));
    }
    // The page of a run shows the clock bounds; here the error bar is the standard deviation.
    parts.iter_mut().for_each(|part| part.bound = None);
    parts
}

fn label(one: &Configuration, parts: &[StagePart]) -> String {
    let Some(total) = one.total() else { return format!("{}: nothing measured", one.name) };
    let stages = parts.iter().map(|part| format!("{} {}", part.name, duration(part.seconds)));
    let stages = stages.collect::<Vec<_>>().join(", ");
    format!("{}: mean {} of {} iterations. {stages}.", one.name, duration(total.mean), total.count)
}

/// Returns the routes of all runs of the configuration: `user-1, user-2 → rack-a`.
fn routes(one: &Configuration) -> String {
    let mut routes: Vec<(&Placement, Vec<String>)> = Vec::new();
    for run in &one.runs {
        let (placement, host) = (&run.placement, run.host_name.to_string());
        let is_same = |other: &Placement| place::route("", other) == place::route("", placement);
        match routes.iter_mut().find(|(other, _)| is_same(other)) {
            Some((_, hosts)) if hosts.contains(&host) => {}
            Some((_, hosts)) => hosts.push(host),
            None => routes.push((placement, vec![host])),
        }
    }
    let route = |(placement, mut hosts): (&Placement, Vec<String>)| {
        hosts.sort_by(|a, b| order::compare_labels(slice::from_ref(a), slice::from_ref(b)));
        let more = hosts.len().saturating_sub(MAX_NAMED_HOSTS);
        hosts.truncate(MAX_NAMED_HOSTS);
        let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
        place::route(&format!("{}{rest}", hosts.join(", ")), placement)
    };
    routes.into_iter().map(route).collect::<Vec<_>>().join("; ")
}

/// Returns the models that ran both on board and in the cloud, each with its inference alone, all on one scale.
pub(crate) fn pairs(comparison: &Comparison) -> (Vec<Pair>, Axes) {
    let mut models: Vec<String> = Vec::new();
    for placement in comparison.configurations.iter().filter_map(Configuration::placement) {
        let model = placement.model.to_string();
        if !models.contains(&model) {
            models.push(model);
        }
    }
    let configurations_of = |model: &str| {
        let measured = comparison.configurations.iter().filter(move |one| {
            one.placement().is_some_and(|placement| placement.model.as_str() == model)
                && one.figures(&stage::INFERENCE).is_some()
        });
        measured.collect::<Vec<_>>()
    };
    let has_both_placements = |model: &String| {
        let has = |kind| configurations_of(model).iter().any(|one| one.kind() == Some(kind));
        has(PlacementKind::Local) && has(PlacementKind::Remote)
    };
    models.retain(has_both_placements);
    let quartiles = |one: &Configuration| Quartiles::of(one.summary(&stage::INFERENCE)?);
    let measured = models.iter().flat_map(|model| configurations_of(model));
    let reach = measured.filter_map(quartiles).map(|quartiles| quartiles.top()).fold(0.0, f64::max);
    let scale = Scale::up_to(reach * 1e3, 6);
    let row = |one: &Configuration| {
        let (figures, quartiles): (_, Quartiles) = (one.figures(&stage::INFERENCE)?, quartiles(one)?);
        let location = if one.kind() == Some(PlacementKind::Local) { "on board" } else { "cloud" };
        let place = format!("{location}, {}", routes(one));
        let label = format!("{}, {place}, inference", one.name);
        let spread = box_plot(&stage::INFERENCE, &label, &quartiles, &scale);
        let inference = mean_std_ms(figures.mean, figures.std);
        Some(PlaceRow { configuration: one.name.clone(), place, inference, spread })
    };
    let pair = |model: &String| {
        let mut places = configurations_of(model);
        places.sort_by_key(|one| one.kind() == Some(PlacementKind::Remote));
        Pair { model: model.clone(), places: places.into_iter().filter_map(row).collect() }
    };
    (models.iter().map(pair).collect(), Axes::of(&scale))
}
