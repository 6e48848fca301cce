//! What made an iteration slow, by comparison with the medians of its run.

use peernet_logger::Name;
use serde::Serialize;

/// Share of an iteration's excess that the causes explain together.
const EXPLAINED: f64 = 0.8;

/// A part of an iteration that took longer than it usually does in its run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Cause {
    /// A stage, `lateness`, `unattributed`, or both directions of the network together.
    pub name: Name,
    /// Seconds it took.
    pub value: f64,
    /// Seconds it takes in the median of the run.
    pub median: f64,
}

impl Cause {
    /// Seconds beyond the run's median.
    pub fn excess(&self) -> f64 {
        self.value - self.median
    }
}

/// Returns the causes of an iteration that took `total` seconds where its run's median is `median`: the parts with the
/// largest excess over their own medians, largest first, until they explain 80 % of the total's excess. Parts must not
/// overlap. Empty where the iteration was no slower than the median.
pub fn causes(total: f64, median: f64, parts: impl IntoIterator<Item = Cause>) -> Vec<Cause> {
    let wanted = EXPLAINED * (total - median);
    let mut slower: Vec<Cause> = parts.into_iter().filter(|part| part.excess() > 0.0).collect();
    slower.sort_by(|a, b| b.excess().total_cmp(&a.excess()));
    let mut explained = 0.0;
    slower
        .into_iter()
        .take_while(|cause| {
            let is_needed = explained < wanted;
            explained += cause.excess();
            is_needed
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(name: &'static str, value: f64, median: f64) -> Cause {
        Cause { name: Name::from_static(name), value, median }
    }

    fn names(causes: &[Cause]) -> Vec<&str> {
        causes.iter().map(|cause| cause.name.as_str()).collect()
    }

    #[test]
    fn causes_are_named_until_most_of_excess_is_explained() {
        let parts = [
            part("sensing", 0.021, 0.020),
            part("lateness", 0.124, 0.002),
            part("inference", 0.231, 0.012),
            part("download", 0.040, 0.021),
        ];
        let found = causes(0.42, 0.055, parts);
        assert_eq!(names(&found), ["inference", "lateness"]);
    }

    #[test]
    fn single_cause_suffices_where_it_explains_most() {
        let parts = [part("upload", 0.0204, 0.0063), part("inference", 0.0121, 0.0105)];
        assert_eq!(names(&causes(0.0335, 0.0178, parts)), ["upload"]);
    }

    #[test]
    fn iteration_no_slower_than_median_has_no_causes() {
        let parts = || [part("upload", 0.010, 0.005), part("inference", 0.005, 0.015)];
        assert_eq!(causes(0.015, 0.020, parts()), []);
        assert_eq!(causes(0.020, 0.020, parts()), []);
    }

    #[test]
    fn faster_parts_are_no_causes() {
        let parts = [part("upload", 0.010, 0.011), part("inference", 0.012, 0.010)];
        assert_eq!(names(&causes(0.1, 0.02, parts)), ["inference"]);
    }
}
