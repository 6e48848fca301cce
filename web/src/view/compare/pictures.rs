//! Pictures of a comparison: the mean stages of each configuration as a bar, and the inference of each model at several
//! places.

use peernet_analysis::compare::{Latency, LatencyBar, compare_label};
use peernet_analysis::model_places::{ModelPlaces, PlacedModel};
use peernet_figures::drawing::{Quartiles, Stacked};
use peernet_figures::plot::Item;
use peernet_figures::scale::Scale;
use peernet_logger::stage;
use peernet_statistics::Summary;
use peernet_statistics::number::{self, NONE, count, duration, fixed_mean_std_ms, mean_std_ms};
use peernet_store::{DelayAccuracy, QuantityStatistics, RunSummary};
use peernet_stream::Placement;

use super::spread::{TICKS, box_plot};
use super::{Comparison, Configuration};
use crate::look;
use crate::picture::Picture;
use crate::view::place;

/// Maximum number of edges of one route that are named.
const MAX_NAMED_HOSTS: usize = 4;
/// Maximum number of configurations of one place that are named.
const MAX_NAMED_CONFIGURATIONS: usize = 3;

/// A configuration's stages as a bar.
pub(crate) struct StackRow {
    pub name: String,
    pub bar: Picture,
    /// Mean total and its standard deviation, ms.
    pub total: (String, Option<String>),
    /// `true` for the best configuration of the ranking.
    pub is_best: bool,
}

/// The labels of a scale: once above all bars, and again below each bar on narrow screens.
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

/// A model that ran at several places, with its inference at each place.
pub(crate) struct ModelByPlace {
    pub model: String,
    pub places: Vec<PlaceRow>,
}

/// Row of a place of a model.
pub(crate) struct PlaceRow {
    /// Names of the configurations of the model at the place.
    pub configuration: String,
    /// Name of the place, the host of the model, and the hosts that it serves.
    pub place: String,
    /// Mean inference and its standard deviation, ms.
    pub inference: (String, Option<String>),
    /// Box plot of the inference.
    pub spread: Picture,
}

/// Returns a bar of the mean stages of each configuration, all on one scale. The error bar is the
/// standard deviation of the total.
pub(crate) fn stacks(comparison: &Comparison, best: Option<usize>) -> (Vec<StackRow>, Axes) {
    let bars: Vec<(String, LatencyBar)> = comparison
        .configurations
        .iter()
        .map(|one| (one.name.clone(), latency_bar(comparison, one).unwrap_or_default()))
        .collect();
    let (title, notes) = ("", Vec::new());
    let (pictures, scale) = Stacked::new(title, &bars, notes).rows();
    let decimals = comparison.mean_decimals(comparison.total_column.name());
    let row = |(index, items): (usize, &Vec<Item>)| {
        let (one, (name, bar)) = (&comparison.configurations[index], &bars[index]);
        StackRow {
            name: name.clone(),
            total: if bar.parts.is_empty() {
                (NONE.to_owned(), None)
            } else {
                fixed_mean_std_ms(bar.total, bar.std, decimals)
            },
            bar: Picture::of_items(items, "stages", &label(one, bar)),
            is_best: best == Some(index),
        }
    };
    (pictures.iter().enumerate().map(row).collect(), Axes::of(&scale))
}

/// Returns the mean latency of a configuration with its parts; `None` without a successful iteration.
pub(super) fn latency_bar(comparison: &Comparison, configuration: &Configuration) -> Option<LatencyBar> {
    let latency_of = |name: &str| {
        let QuantityStatistics { count, mean, std, .. } = *configuration.statistics(name)?;
        Some(Latency { mean, std, count })
    };
    LatencyBar::new(
        comparison.total_column,
        configuration.iterations(),
        DelayAccuracy::sent_messages(&configuration.bounds),
        latency_of,
    )
}

fn label(configuration: &Configuration, bar: &LatencyBar) -> String {
    if bar.parts.is_empty() {
        return format!("{}: nothing measured", configuration.name);
    }
    let stages =
        bar.parts.iter().map(|(name, seconds)| format!("{} {}", look::label(name), duration(*seconds)));
    let stages = stages.collect::<Vec<_>>().join(", ");
    format!(
        "{}: mean {} of {} iterations. {stages}.",
        configuration.name,
        duration(bar.total),
        count(configuration.iterations())
    )
}

/// Returns the routes of some runs: `user-1, user-2 → rack-a`.
fn routes(runs: &[&RunSummary]) -> String {
    let mut routes: Vec<(&Placement, Vec<String>)> = Vec::new();
    for run in runs {
        let (placement, host) = (&run.placement, run.host_name.to_string());
        // Without the name of the edge, two runs with the same cloud have the same route.
        let is_same = |other: &Placement| place::route("", other) == place::route("", placement);
        match routes.iter_mut().find(|(other, _)| is_same(other)) {
            Some((_, hosts)) if hosts.contains(&host) => {}
            Some((_, hosts)) => hosts.push(host),
            None => routes.push((placement, vec![host])),
        }
    }
    let route = |(placement, mut hosts): (&Placement, Vec<String>)| {
        hosts.sort_by(|a, b| compare_label(a, b));
        let more = hosts.len().saturating_sub(MAX_NAMED_HOSTS);
        hosts.truncate(MAX_NAMED_HOSTS);
        let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
        place::route(&format!("{}{rest}", hosts.join(", ")), placement)
    };
    routes.into_iter().map(route).collect::<Vec<_>>().join("; ")
}

/// Returns the models that ran at several places, such as on board and in the cloud. Only the inference is compared, on
/// one scale. All runs of a model at one place are combined. Repeats of one configuration may be at several places, such
/// as on two devices.
pub(crate) fn models_by_place(comparison: &Comparison) -> (Vec<ModelByPlace>, Axes) {
    let runs = comparison.configurations.iter().flat_map(|one| one.runs.iter().map(move |run| (one, run)));
    let measured: Vec<MeasuredRun<'_>> = runs
        .filter_map(|(configuration, run)| {
            let inference = comparison.summary(run.number, &stage::INFERENCE)?;
            Some(MeasuredRun { configuration: &configuration.name, run, inference })
        })
        .collect();
    let placed = measured.iter().map(|MeasuredRun { run: RunSummary { placement, .. }, .. }| PlacedModel {
        model: placement.model.to_string(),
        kind: placement.kind.name().to_owned(),
        device: placement.device.clone().unwrap_or_default(),
    });
    let all = ModelPlaces::new(&placed.collect::<Vec<_>>());
    let models = all.models.iter();
    let rows: Vec<(&String, Vec<PlaceValues<'_>>)> = models
        .map(|(model, places)| {
            let values = all.places.iter().zip(places).filter_map(|(place, indexes)| {
                PlaceValues::of(place, indexes.iter().map(|index| &measured[*index]))
            });
            (model, values.collect())
        })
        .collect();
    let upper_ends = rows.iter().flat_map(|(_, places)| places).map(|place| place.quartiles.largest_drawn());
    let scale = Scale::up_to(upper_ends.fold(0.0, f64::max) * 1e3, TICKS);
    let model_by_place = |(model, places): &(&String, Vec<PlaceValues<'_>>)| ModelByPlace {
        model: (*model).clone(),
        places: places.iter().map(|place| place.row(&scale)).collect(),
    };
    (rows.iter().map(model_by_place).collect(), Axes::of(&scale))
}

/// A run with values of the inference.
struct MeasuredRun<'a> {
    /// Name of the configuration.
    configuration: &'a str,
    run: &'a RunSummary,
    inference: &'a Summary,
}

/// Inference of a model at one place.
struct PlaceValues<'a> {
    place: &'a str,
    /// Names of the configurations, each once.
    configurations: Vec<&'a str>,
    runs: Vec<&'a RunSummary>,
    values: Summary,
    quartiles: Quartiles,
}

impl<'a> PlaceValues<'a> {
    /// Combines runs, which are in the order of their configurations; `None` without values.
    fn of(place: &'a str, measured: impl Iterator<Item = &'a MeasuredRun<'a>>) -> Option<Self> {
        let (mut configurations, mut runs, mut values) = (Vec::new(), Vec::new(), Summary::default());
        for MeasuredRun { configuration, run, inference } in measured {
            configurations.push(*configuration);
            runs.push(*run);
            values.merge(inference);
        }
        configurations.dedup();
        let quartiles = Quartiles::of(&values)?;
        Some(Self { place, configurations, runs, values, quartiles })
    }

    fn row(&self, scale: &Scale) -> PlaceRow {
        let configuration = match self.configurations.as_slice() {
            names if names.len() <= MAX_NAMED_CONFIGURATIONS => names.join(" + "),
            names => number::counted(names.len() as u64, "configuration"),
        };
        let place = format!("{}: {}", self.place, routes(&self.runs));
        let label = format!("{configuration}, {place}, inference");
        let moments = self.values.moments;
        PlaceRow {
            spread: box_plot(&stage::INFERENCE, &label, &self.quartiles, scale),
            inference: mean_std_ms(moments.mean, moments.std()),
            configuration,
            place,
        }
    }
}
