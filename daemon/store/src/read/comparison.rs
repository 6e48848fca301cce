//! What made an iteration slow, by comparison with its run.

use peernet_logger::{Name, stage};

use crate::figures::Figures;
use crate::types::{BOTH_WAYS, Blame};

/// The run's figures, with which its iterations are compared.
pub(super) struct Comparison(pub(super) Vec<(Name, Figures)>);

impl Comparison {
    fn median(&self, name: &str) -> Option<f64> {
        self.0.iter().find(|(known, _)| known == name).map(|(_, figures)| figures.p50)
    }

    /// What `upload` and `download` take together: where neither is ever known, what the total's median holds beyond
    /// the others'.
    fn both_ways(&self) -> Option<f64> {
        let known = [stage::UPLOAD, stage::DOWNLOAD].into_iter().filter_map(|name| self.median(&name));
        let known: Vec<f64> = known.collect();
        if !known.is_empty() {
            return Some(known.iter().sum());
        }
        let others: f64 = stage::ORDER.iter().filter_map(|name| self.median(name)).sum();
        Some((self.median(&stage::TOTAL)? - others - self.median(&stage::UNATTRIBUTED)?).max(0.0))
    }

    pub(super) fn factor(&self, total: Option<f64>) -> Option<f64> {
        let median = self.median(&stage::TOTAL).filter(|median| *median > 0.0)?;
        Some(total? / median)
    }

    /// What exceeds its own median most. What no stage accounts for is a candidate like any stage, and so are both
    /// ways together: blaming the second largest excess would send the reader to the wrong place.
    pub(super) fn blame(
        &self,
        stages: &[(Name, f64)],
        unattributed: Option<f64>,
        both_ways: Option<f64>,
    ) -> Option<Blame> {
        let rest = unattributed.map(|value| (stage::UNATTRIBUTED, value));
        let compared = stages.iter().chain(&rest).filter_map(|(stage, value)| {
            Some(Blame { stage: stage.clone(), value: *value, median: self.median(stage)? })
        });
        let network = both_ways.zip(self.both_ways());
        let network =
            network.map(|(value, median)| Blame { stage: Name::from_static(BOTH_WAYS), value, median });
        let over = |blame: &Blame| blame.value - blame.median;
        compared.chain(network).filter(|blame| over(blame) > 0.0).max_by(|a, b| over(a).total_cmp(&over(b)))
    }
}
