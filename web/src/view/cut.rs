//! Limits of long lists, so that a page stays readable and a live page cheap.

use peernet_statistics::number::count;

/// Pipelines, and hosts, on the overview.
pub(crate) const OVERVIEW: usize = 100;
/// Rows of a list on a separate page.
pub(crate) const LIST: usize = 500;

/// Returns `the first 100 of 5,000`, where not all of a list are shown.
pub(crate) fn words(most: usize, all: usize) -> Option<String> {
    (all > most).then(|| format!("the first {} of {}", count(most as u64), count(all as u64)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_is_said_to_be_cut_only_where_it_is() {
        assert_eq!(words(100, 100), None);
        assert_eq!(words(100, 5_000).as_deref(), Some("the first 100 of 5,000"));
    }
}
