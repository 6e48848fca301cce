//! Statistics of judged delays and of their accuracy.

use peernet_analysis::delays::VerdictCounts;
use peernet_clock::OneWayDelay;
use peernet_statistics::Summary;

use crate::quantity_statistics::QuantityStatistics;
use crate::types::Judgement;

/// Statistics of the delays of one direction, to which delays are added.
#[derive(Debug, Default)]
pub(super) struct DelaySums {
    delay: Summary,
    half_width: Summary,
    verdicts: VerdictCounts,
}

impl DelaySums {
    /// Adds a delay; a delay that was never judged is ignored.
    pub(super) fn add(&mut self, delay: Option<&OneWayDelay>) {
        let Some(delay) = delay else { return };
        if let Some(value) = delay.value {
            self.delay.record(value.seconds());
        }
        if let Some(half_width) = delay.half_width() {
            self.half_width.record(half_width);
        }
        self.verdicts.add(delay.verdict, 1);
    }

    pub(super) fn is_empty(&self) -> bool {
        self.verdicts.is_empty()
    }

    pub(super) fn judgement(&self) -> Judgement {
        Judgement {
            delay: QuantityStatistics::from_summary(&self.delay),
            half_width: QuantityStatistics::from_summary(&self.half_width),
            verdicts: self.verdicts.counts().collect(),
        }
    }
}
