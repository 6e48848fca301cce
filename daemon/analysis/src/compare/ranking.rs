//! Configuration with the smallest mean, and the differences between the other configurations and the smallest mean.

use super::difference::{Difference, MeanEstimate};

/// Ranking of several configurations by their means.
#[derive(Clone, Debug, PartialEq)]
pub struct Ranking {
    /// Index of the configuration with the smallest mean.
    pub best: usize,
    /// Index of each other ranked configuration, and its mean minus the smallest mean. The difference is `None` if the
    /// configuration has no mean.
    pub differences: Vec<(usize, Option<Difference>)>,
    /// Indexes of the ranked configurations that have a mean and enough values for an interval: at least
    /// [`MIN_VALUES`](super::MIN_VALUES) of each run with values.
    pub with_enough_values: Vec<usize>,
}

/// Total latency of a configuration, by which it is ranked.
#[derive(Clone, Debug, PartialEq)]
pub struct ConfigurationTotal {
    /// `false` if the model of at least one run only returns its input: see [`model_computes`].
    pub model_computes: bool,
    /// Mean of the [`TotalColumn`](crate::total_column::TotalColumn) of all configurations; `None` without
    /// measurements.
    pub mean: Option<MeanEstimate>,
}

impl Ranking {
    /// Ranks configurations by their means, without those of [`find_unranked`]. Returns `None` if fewer than two
    /// configurations can be ranked, or if none of these configurations has a mean.
    pub fn new(configurations: &[ConfigurationTotal]) -> Option<Self> {
        let unranked = find_unranked(configurations);
        let ranked: Vec<usize> =
            (0..configurations.len()).filter(|index| !unranked.contains(index)).collect();
        (ranked.len() > 1).then_some(())?;
        let mean = |index: &usize| configurations[*index].mean.as_ref();
        let with_mean = ranked.iter().filter_map(|index| Some((*index, mean(index)?)));
        let (best, smallest) = with_mean.min_by(|a, b| a.1.mean().total_cmp(&b.1.mean()))?;
        let others = ranked.iter().filter(|index| **index != best);
        let difference =
            |index: &usize| (*index, mean(index).map(|mean| Difference::between_means(smallest, mean)));
        let differences = others.map(difference).collect();
        let has_enough_values = |index: &usize| mean(index).is_some_and(MeanEstimate::has_enough_values);
        let with_enough_values = ranked.iter().copied().filter(has_enough_values).collect();
        Some(Self { best, differences, with_enough_values })
    }

    /// Returns the indexes of the configurations whose difference from the smallest mean may be chance: the 95 %
    /// confidence interval of the difference contains zero.
    pub fn ties(&self) -> Vec<usize> {
        self.indexes_by_verdict(Some(false))
    }

    /// Returns the indexes of the configurations that have too few values for a test.
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

/// Returns the indexes of the configurations that are not ranked: their model computes nothing, but the model of at
/// least one other configuration computes something.
pub fn find_unranked(configurations: &[ConfigurationTotal]) -> Vec<usize> {
    let any_model_computes = configurations.iter().any(|configuration| configuration.model_computes);
    (0..configurations.len())
        .filter(|index| configurations[*index].model_computes != any_model_computes)
        .collect()
}

/// Returns the index of the configuration that is the baseline unless the user names one: the best, or the first if none
/// is the best.
pub fn default_baseline(best: Option<usize>) -> usize {
    best.unwrap_or(0)
}

/// Returns whether the model of a run computes something, from the facts of the run. A model that only returns its
/// input is not ranked with models that compute, because its latency is small without any work.
pub fn model_computes(facts: &[(String, String)]) -> bool {
    // The model kind `echo` describes itself by one of these facts.
    let is_echo = |fact: &str| fact == "echo" || fact.starts_with("echo, ");
    !facts.iter().any(|(name, fact)| name.eq_ignore_ascii_case("model") && is_echo(fact))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the total of a model that computes: values that vary by one about a mean.
    fn total(mean: f64, count: usize) -> ConfigurationTotal {
        let values: Vec<f64> = (0..count).map(|n| mean + (n as f64).sin()).collect();
        ConfigurationTotal { model_computes: true, mean: MeanEstimate::from_values(&[values]) }
    }

    fn echo(mean: f64) -> ConfigurationTotal {
        ConfigurationTotal { model_computes: false, ..total(mean, 300) }
    }

    #[test]
    fn configurations_are_distinct_tied_or_untested() {
        let all = [total(5.0, 300), echo(0.5), total(1.01, 300), total(1.0, 300)];
        let few = [total(0.0, 0), total(3.0, 20)];
        let configurations = [&all[..], &few].concat();
        let ranking = Ranking::new(&configurations).expect("several have a mean");
        assert_eq!((ranking.best, ranking.ties(), ranking.untested()), (3, vec![2], vec![4, 5]));
        assert_eq!(find_unranked(&configurations), [1], "its model computes nothing");
        let (index, difference) = ranking.differences[0];
        assert_eq!((index, difference.and_then(|difference| difference.is_distinct())), (0, Some(true)));
    }

    #[test]
    fn ranking_needs_two_configurations_and_a_mean() {
        assert_eq!(Ranking::new(&[total(1.0, 300)]), None);
        assert_eq!(Ranking::new(&[total(0.0, 0), total(0.0, 0)]), None);
    }

    #[test]
    fn one_ranked_configuration_has_no_ranking() {
        let configurations = [total(1.0, 300), echo(0.5), echo(2.0)];
        assert_eq!(Ranking::new(&configurations), None);
        assert_eq!(find_unranked(&configurations), [1, 2]);
    }

    #[test]
    fn models_that_compute_nothing_are_ranked_among_themselves() {
        let configurations = [echo(2.0), echo(1.0)];
        let ranking = Ranking::new(&configurations).expect("two configurations");
        assert_eq!((ranking.best, find_unranked(&configurations).len()), (1, 0));
    }

    #[test]
    fn model_that_only_echoes_computes_nothing() {
        let facts = |fact: &str| [("Model".to_owned(), fact.to_owned())];
        assert!(!model_computes(&facts("echo")) && !model_computes(&facts("echo, answers with 10 bytes")));
        assert!(model_computes(&facts("echo-cancellation 1.0")) && model_computes(&[]));
    }
}
