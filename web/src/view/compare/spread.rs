//! Spread of the totals of a comparison, from the statistics stored of each whole run. No iteration is read.

use peernet_figures::drawing::Quartiles;
use peernet_figures::scale::Scale;
use peernet_logger::stage;
use peernet_statistics::number::milliseconds;

use super::{Axes, Comparison, Configuration};
use crate::picture::Picture;

/// A configuration's total as a box.
pub(crate) struct BoxRow {
    pub name: String,
    pub median: String,
    pub quartiles: String,
    pub picture: Picture,
}

/// Draws the five numbers of a stage; `of` names the quantity in words.
pub(super) fn boxed(stage: &str, of: &str, five: &Quartiles, scale: &Scale) -> Picture {
    Picture::of_items(&five.items(stage, scale), "stages thin boxed", &format!("{of}: {}", five.words()))
}

/// Returns the total of each configuration, its runs together, all on one scale.
pub(crate) fn boxes(comparison: &Comparison) -> (Vec<BoxRow>, Axes) {
    let known = comparison.configurations.iter();
    let known: Vec<_> =
        known.filter_map(|one| Some((one, Quartiles::of(one.known(&stage::TOTAL)?)?))).collect();
    let scale = Scale::up_to(known.iter().map(|(_, five)| five.top()).fold(0.0, f64::max) * 1e3, 6);
    let row = |(one, five): &(&Configuration, Quartiles)| {
        let [p25, p50, p75] = five.middle.map(milliseconds);
        BoxRow {
            name: one.name.clone(),
            median: p50,
            quartiles: format!("{p25} – {p75}"),
            picture: boxed(&stage::TOTAL, &format!("{}, total", one.name), five, &scale),
        }
    };
    (known.iter().map(row).collect(), Axes::of(&scale))
}
