//! Limits of long lists, so that pages stay readable and live pages cheap to update.

use peernet_statistics::number::count;

/// Maximum number of pipelines, and of hosts, on the overview.
pub(crate) const MAX_ON_OVERVIEW: usize = 100;
/// Maximum number of rows of a list that has a separate page.
pub(crate) const MAX_IN_LIST: usize = 500;

/// Returns `the first 100 of 5,000`; `None` if the whole list is shown.
pub(crate) fn truncation_note(limit: usize, all: usize) -> Option<String> {
    (all > limit).then(|| format!("the first {} of {}", count(limit as u64), count(all as u64)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_truncated_list_has_a_note() {
        assert_eq!(truncation_note(100, 100), None);
        assert_eq!(truncation_note(100, 5_000).as_deref(), Some("the first 100 of 5,000"));
    }
}
