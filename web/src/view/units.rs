//! Units in which quantities are shown.

/// Returns the unit in which a quantity is shown, and the factor from its SI value.
pub(crate) fn shown_in(unit: &str) -> (String, f64) {
    match unit {
        "s" => ("ms".to_owned(), 1e3),
        "bit/s" => ("MB/s".to_owned(), 1.0 / 8e6),
        "B" => ("kB".to_owned(), 1e-3),
        other => (other.to_owned(), 1.0),
    }
}
