//! Configuration with the smallest mean, and the differences of the others to it.

use super::difference::{Difference, MeanEstimate};

/// Ranking of several configurations by their means.
#[derive(Clone, Debug, PartialEq)]
pub struct Ranking {
    /// Index of the configuration with the smallest mean.
    pub best: usize,
    /// Index of each other configuration, and its mean minus the smallest mean; `None` if it has no mean.
    pub differences: Vec<(usize, Option<Difference>)>,
}

impl Ranking {
    /// Ranks configurations by their means. A configuration is an index and an estimate; without measurements the estimate is `None`. Returns
    /// `None` for fewer than two configurations, and if no configuration has an estimate.
    pub fn from_means(configurations: &[(usize, Option<MeanEstimate>)]) -> Option<Self> {
        (configurations.len() > 1).then_some(())?;
        let with_estimate =
            configurations.iter().filter_map(|(index, estimate)| Some((*index, estimate.as_ref()?)));
        let (best, smallest) = with_estimate.min_by(|a, b| a.1.mean().total_cmp(&b.1.mean()))?;
        let others = configurations.iter().filter(|(index, _)| *index != best);
        let difference = |(index, estimate): &(usize, Option<MeanEstimate>)| {
            (*index, estimate.as_ref().map(|estimate| Difference::between_means(smallest, estimate)))
        };
        let differences = others.map(difference).collect();
        Some(Self { best, differences })
    }

    /// Returns the indexes of the configurations whose means do not differ from the smallest with 95 % confidence.
    pub fn ties(&self) -> Vec<usize> {
        self.indexes_by_verdict(Some(false))
    }

    /// Returns the indexes of the configurations for which there are too few values for a test.
    pub fn untested(&self) -> Vec<usize> {
        self.indexes_by_verdict(None)
    }

    /// Returns the indexes of the configurations whose difference has this result of [`Difference::is_distinct`].
    fn indexes_by_verdict(&self, is_distinct: Option<bool>) -> Vec<usize> {
        let verdict =
            |difference: &Option<Difference>| difference.and_then(|difference| difference.is_distinct());
        self.differences
            .iter()
            .filter(|(_, difference)| verdict(difference) == is_distinct)
            .map(|(index, _)| *index)
            .collect()
    }
}

/// Returns whether the model of a run computes something, from the facts of the run. A model that only returns its input is not ranked with
/// models that compute.
pub fn model_computes(facts: &[(String, String)]) -> bool {
    // The model kind `echo` describes itself by one of these facts.
    let is_echo = |fact: &str| fact == "echo" || fact.starts_with("echo, ");
    !facts.iter().any(|(name, fact)| name.eq_ignore_ascii_case("model") && is_echo(fact))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the estimate of values that vary by one about a mean.
    fn estimate(mean: f64, count: usize) -> Option<MeanEstimate> {
        MeanEstimate::from_values(&[(0..count).map(|n| mean + (n as f64).sin()).collect()])
    }

    #[test]
    fn configurations_are_distinct_alike_or_untested() {
        let all = [(0, estimate(5.0, 300)), (2, estimate(1.01, 300)), (4, estimate(1.0, 300))];
        let few = [(5, None), (7, estimate(3.0, 20))];
        let ranking = Ranking::from_means(&[&all[..], &few].concat()).expect("several have a mean");
        assert_eq!((ranking.best, ranking.ties(), ranking.untested()), (4, vec![2], vec![5, 7]));
        let (place, difference) = ranking.differences[0];
        assert_eq!((place, difference.and_then(|difference| difference.is_distinct())), (0, Some(true)));
    }

    #[test]
    fn one_configuration_is_not_ranked() {
        assert_eq!(Ranking::from_means(&[(0, estimate(1.0, 300))]), None);
        assert_eq!(Ranking::from_means(&[(0, None), (1, None)]), None);
    }

    #[test]
    fn model_that_only_echoes_computes_nothing() {
        let facts = |fact: &str| [("Model".to_owned(), fact.to_owned())];
        assert!(!model_computes(&facts("echo")) && !model_computes(&facts("echo, answers with 10 bytes")));
        assert!(model_computes(&facts("echo-cancellation 1.0")) && model_computes(&[]));
    }
}
