//! Units in which quantities are shown.

use peernet_analysis::summary::Scale;
use peernet_figures::plot::Unit;

/// Upper limit of the numbers on an axis of sizes. Larger numbers would be too wide for a phone, so the axis has a
/// larger unit.
const MAX_AXIS_BYTES: f64 = 1e5;

/// Returns the unit of an axis that ends at this value. Axes of sizes are in B, kB, MB or GB.
pub(crate) fn axis_unit(unit: &str, end: f64) -> Unit {
    let scale = Scale::for_unit(unit);
    if scale != Scale::Bytes {
        return Unit::symbol(scale.symbol(unit), scale.factor());
    }
    let units = [("B", 1.0), ("kB", 1e-3), ("MB", 1e-6), ("GB", 1e-9)];
    let fits = |(_, per_byte): &&(&str, f64)| end * per_byte < MAX_AXIS_BYTES;
    let (symbol, per_byte) = units.iter().find(fits).unwrap_or(&units[units.len() - 1]);
    Unit::symbol(symbol, *per_byte)
}

/// Returns the unit in which a quantity is shown, and the factor from the SI unit `unit` to the shown unit.
pub(crate) fn display_unit(unit: &str) -> (String, f64) {
    let scale = Scale::for_unit(unit);
    (scale.symbol(unit).to_owned(), scale.factor())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axis_of_sizes_has_short_marks() {
        let symbols = [44.0, 9e4, 1.2e6, 3e9].map(|end| axis_unit("B", end).symbol.into_owned());
        assert_eq!(symbols, ["B", "B", "kB", "MB"]);
        assert_eq!(axis_unit("s", 1e9), Unit::symbol("ms", 1e3));
        let texts = [44.0, 1_228_800.0].map(|bytes| axis_unit("B", bytes).format_value(bytes, 0.0));
        assert_eq!(texts, ["44 B", "1,229 kB"]);
    }
}
