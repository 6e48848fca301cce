//! Pictures of a comparison: stacks, pairs of local and cloud.

use peernet_analysis::compare::{Latency, LatencyBar};
use peernet_figures::drawing::{Quartiles, Stacked};
use peernet_figures::plot::Item;
use peernet_figures::scale::Scale;
use peernet_logger::stage;
use peernet_statistics::number::{NONE, duration, mean_std_ms};
use peernet_store::{DelayAccuracy, QuantityStatistics};
use peernet_stream::{Placement, PlacementKind};
use std::slice;

use super::spread::box_plot;
use super::{Comparison, Configuration, order};
use crate::picture::Picture;
use crate::view::place;

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
    let bars: Vec<(String, LatencyBar)> = comparison
        .configurations
        .iter()
        .map(|one| (one.name.clone(), latency_bar(comparison, one).unwrap_or_default()))
        .collect();
    let (pictures, scale) = Stacked::new("", &bars, Vec::new()).rows();
    let row = |(index, items): (usize, &Vec<Item>)| {
        let (one, (name, bar)) = (&comparison.configurations[index], &bars[index]);
        StackRow {
            name: name.clone(),
            total: if bar.parts.is_empty() {
                (NONE.to_owned(), None)
            } else {
                mean_std_ms(bar.total, bar.std)
            },
            bar: Picture::of_items(items, "stages", &label(one, bar)),
            best: best == Some(index),
        }
    };
    (pictures.iter().enumerate().map(row).collect(), Axes::of(&scale))
}

/// Returns the mean latency of a configuration with its parts; `None` without an answered iteration.
pub(super) fn latency_bar(comparison: &Comparison, one: &Configuration) -> Option<LatencyBar> {
    let latency_of = |name: &str| {
        let QuantityStatistics { count, mean, std, .. } = *one.figures(name)?;
        Some(Latency { mean, std, count })
    };
    LatencyBar::new(comparison.total_column, one.iterations(), DelayAccuracy::sent(&one.bounds), latency_of)
}

fn label(one: &Configuration, bar: &LatencyBar) -> String {
    if bar.parts.is_empty() {
        return format!("{}: nothing measured", one.name);
    }
    let stages = bar.parts.iter().map(|(name, seconds)| format!("{name} {}", duration(*seconds)));
    let stages = stages.collect::<Vec<_>>().join(", ");
    format!("{}: mean {} of {} iterations. {stages}.", one.name, duration(bar.total), one.iterations())
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
