//! What made an iteration slow, clocks that were never related included.

use peernet_aggregator::{Figures, IterationRow};
use peernet_logger::{Name, stage};

use crate::look;

/// The part of an iteration that explains most of its slowness.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Cause {
    /// A stage, or both directions of the network together.
    pub name: String,
    /// Seconds it took.
    pub value: f64,
    /// Seconds it usually takes in this run.
    pub usual: f64,
}

/// What both directions of the network take together in the mean of a run whose clocks do not tell them apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct UnknownNetwork {
    /// Both directions, seconds.
    pub mean: f64,
}

impl UnknownNetwork {
    /// From the means of a run; `None` when the directions are known or nothing was sent.
    pub(crate) fn of(mean: impl Fn(&str) -> Option<Figures>, sent: bool) -> Option<Self> {
        let total = mean(&stage::TOTAL)?;
        if !sent || mean(&stage::UPLOAD).is_some() || mean(&stage::DOWNLOAD).is_some() {
            return None;
        }
        let known: f64 = stage::ORDER
            .iter()
            .filter_map(|name| mean(name))
            .map(|figures| figures.mean * figures.count as f64 / total.count.max(1) as f64)
            .sum();
        let unattributed = mean(&stage::UNATTRIBUTED)?.mean;
        Some(Self { mean: total.mean - known - unattributed }).filter(|network| network.mean > 0.0)
    }

    /// Both directions in one iteration of a list: what is left of its total beside the stages and its own
    /// remainder, which the edge measured without needing the clocks' relation.
    pub(crate) fn within(row: &IterationRow) -> Option<f64> {
        let known: f64 = row.stages.iter().map(|(_, seconds)| seconds).sum();
        Some((row.total? - known - row.unattributed?).max(0.0))
    }
}

impl Cause {
    /// The stage that the store blames, or the network where that exceeds its mean by more.
    pub(crate) fn of(row: &IterationRow, network: Option<(f64, UnknownNetwork)>) -> Option<Self> {
        let blamed = row.blame.as_ref().map(|blame| Self {
            name: blame.stage.to_string(),
            value: blame.value,
            usual: blame.median,
        });
        let network =
            network.map(|(value, usual)| Self { name: look::NETWORK.to_owned(), value, usual: usual.mean });
        let excess = |cause: &Self| cause.value - cause.usual;
        let worst = blamed.into_iter().chain(network).max_by(|a, b| excess(a).total_cmp(&excess(b)));
        worst.filter(|cause| excess(cause) > 0.0)
    }
}

/// Figures of a name among a run's.
pub(crate) fn figures_of<'a>(figures: &'a [(Name, Figures)]) -> impl Fn(&str) -> Option<Figures> + 'a {
    |name| figures.iter().find(|(known, _)| known == name).map(|(_, figures)| *figures)
}

#[cfg(test)]
mod tests {
    use peernet_aggregator::Blame;

    use super::*;
    use crate::view::samples;

    #[test]
    fn the_network_is_blamed_where_no_stage_explains_the_slowness() {
        let mut row = samples::iteration().row;
        row.total = Some(0.039);
        row.stages = vec![(stage::SENSING, 0.005), (stage::INFERENCE, 0.0036)];
        row.blame = Some(Blame { stage: stage::INFERENCE, value: 0.0036, median: 0.0035 });
        row.unattributed = Some(0.0001);
        let usual = UnknownNetwork { mean: 0.007 };
        let network = UnknownNetwork::within(&row).expect("it has a total");
        assert!((network - 0.0303).abs() < 1e-9);
        assert_eq!(Cause::of(&row, Some((network, usual))).expect("slow").name, look::NETWORK);
        assert_eq!(Cause::of(&row, None).expect("slow").name, "inference");
    }

    #[test]
    fn what_no_stage_accounts_for_is_not_laid_at_the_networks_door() {
        let mut row = samples::iteration().row;
        row.total = Some(0.630);
        row.stages = vec![(stage::SENSING, 0.005), (stage::INFERENCE, 0.0036)];
        row.unattributed = Some(0.618);
        row.blame = Some(Blame { stage: stage::UNATTRIBUTED, value: 0.618, median: 0.0002 });
        let network = UnknownNetwork::within(&row).expect("it has a total");
        assert!((network - 0.0034).abs() < 1e-9);
        let cause = Cause::of(&row, Some((network, UnknownNetwork { mean: 0.003 }))).expect("slow");
        assert_eq!(cause.name, "unattributed");
    }

    #[test]
    fn directions_that_are_known_need_no_sum() {
        let one = |value| Figures {
            count: 9,
            mean: value,
            std: None,
            min: value,
            p50: value,
            p95: None,
            p99: None,
            max: value,
        };
        let known = UnknownNetwork::of(
            |name| matches!(name, "total" | "upload" | "unattributed").then(|| one(0.01)),
            true,
        );
        assert_eq!(known, None);
        let unknown = |name: &str| match name {
            "total" => Some(one(0.020)),
            "sensing" => Some(one(0.005)),
            "unattributed" => Some(one(0.001)),
            _ => None,
        };
        let network = UnknownNetwork::of(unknown, true).expect("sent and unknown");
        assert!((network.mean - 0.014).abs() < 1e-12);
        assert_eq!(UnknownNetwork::of(unknown, false), None);
    }
}
