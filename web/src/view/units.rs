//! Units in which quantities are shown.

use peernet_analysis::summary::Scale;

/// Returns the unit in which a quantity is shown, and the factor from its SI value.
pub(crate) fn shown_in(unit: &str) -> (String, f64) {
    let scale = Scale::for_unit(unit);
    (scale.symbol(unit).to_owned(), scale.factor())
}
