//! Spread of the totals of a comparison, from the stored statistics of whole runs. No iteration is read.

use peernet_figures::drawing::Quartiles;
use peernet_figures::scale::Scale;
use peernet_statistics::number::{join_ends, milliseconds};

use super::{Axes, Comparison, Configuration};
use crate::picture::Picture;

/// Approximate number of ticks of a scale.
pub(super) const TICKS: usize = 6;

/// A configuration's total as a box.
pub(crate) struct BoxRow {
    pub name: String,
    pub median: String,
    /// First and third quartile, ms.
    pub quartiles: String,
    pub picture: Picture,
}

/// Draws the box plot of a stage. `quantity` names the quantity in words.
pub(super) fn box_plot(stage: &str, quantity: &str, quartiles: &Quartiles, scale: &Scale) -> Picture {
    Picture::of_items(
        &quartiles.items(stage, scale),
        "stages thin boxed",
        &format!("{quantity}: {}", quartiles.description()),
    )
}

/// Returns a box for the total of each configuration, all on one scale. The runs of a configuration are combined.
pub(crate) fn boxes(comparison: &Comparison) -> (Vec<BoxRow>, Axes) {
    let total = comparison.total_column.name();
    let measured: Vec<_> = comparison
        .configurations
        .iter()
        .filter_map(|one| Some((one, Quartiles::of(one.summary(total)?)?)))
        .collect();
    let scale = Scale::up_to(
        measured.iter().map(|(_, quartiles)| quartiles.largest_drawn()).fold(0.0, f64::max) * 1e3,
        TICKS,
    );
    let row = |(one, quartiles): &(&Configuration, Quartiles)| {
        let [p25, p50, p75] = quartiles.values.map(milliseconds);
        BoxRow {
            name: one.name.clone(),
            median: p50,
            quartiles: join_ends([p25, p75]),
            picture: box_plot(total, &format!("{}, {total}", one.name), quartiles, &scale),
        }
    };
    (measured.iter().map(row).collect(), Axes::of(&scale))
}
