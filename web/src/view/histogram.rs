//! Picture of the distribution of one quantity of a run.

use peernet_figures::drawing::{CountNoun, Distribution, View};
use peernet_figures::look::stage;
use peernet_logger::IterationValues;
use peernet_store::Histogram;

use super::units::axis_unit;
use crate::picture::Picture;

/// Width of the plot on the narrowest phones, in ems: multiples of the font size of its labels.
const NARROWEST_EMS: f64 = 19.6;

/// Draws a distribution with lines at its quantiles. A quantile beyond the last edge has no line.
pub(crate) fn histogram(stored: &Histogram, view: View, is_logarithmic: bool) -> Picture {
    let last_edge = stored.edges.last().copied().unwrap_or_default();
    let unit = axis_unit(&stored.unit, last_edge);
    let statistics = &stored.statistics;
    let quantiles = [("median", Some(statistics.p50)), ("p95", statistics.p95), ("p99", statistics.p99)];
    let quantiles: Vec<(&str, f64)> = quantiles
        .into_iter()
        .filter_map(|(name, value)| Some((name, value?)))
        .filter(|(_, value)| *value <= last_edge)
        .collect();
    // Without a spread, a value has three significant digits.
    let spread = 0.0;
    let quantile_texts =
        quantiles.iter().map(|(name, value)| format!("{name} {}", unit.format_value(*value, spread)));
    let label =
        format!("Distribution of {}: {}", stored.stage, quantile_texts.collect::<Vec<_>>().join(", "));
    let distribution = Distribution {
        edges: stored.edges.clone(),
        counts: stored.counts.clone(),
        count_noun: if IterationValues::has_one_value(&stored.stage) {
            CountNoun::Iterations
        } else {
            CountNoun::Values
        },
        beyond: (stored.below, stored.beyond),
        quantiles,
        unit,
        // A throughput has the colour of its direction.
        stage: stage(stored.stage.trim_end_matches("-throughput")),
        view,
        is_logarithmic,
        min_width_em: NARROWEST_EMS,
    };
    Picture::of_plot(&distribution.plot(), "plot-with-axes", &label)
}
