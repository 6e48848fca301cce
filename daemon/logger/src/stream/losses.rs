//! What was dropped and has not been reported yet.

use peernet_clock::WallTime;

use super::Gap;
use crate::{RunId, Slug};

/// Kinds of losses told apart; beyond that they are counted together. An agent has few pipelines and few reasons.
const MOST: usize = 64;

/// Dropped events by pipeline, run and reason.
#[derive(Clone, Debug, Default)]
pub(super) struct Losses {
    gaps: Vec<Gap>,
}

impl Losses {
    /// Counts `count` events dropped at `at`.
    pub(super) fn add(
        &mut self,
        pipeline: Option<Slug>,
        run: Option<RunId>,
        at: WallTime,
        count: u64,
        reason: String,
    ) {
        let same = |gap: &&mut Gap| gap.pipeline == pipeline && gap.run == run && gap.reason == reason;
        if let Some(gap) = self.gaps.iter_mut().find(same) {
            gap.count += count;
            gap.to = at;
        } else if self.gaps.len() < MOST {
            self.gaps.push(Gap { pipeline, run, from: at, to: at, count, reason });
        } else {
            let gap = &mut self.gaps[MOST - 1];
            (gap.pipeline, gap.run, gap.reason) = (None, None, "many different losses".into());
            gap.count += count;
            gap.to = at;
        }
    }

    /// How many gaps there are to report.
    pub(super) const fn len(&self) -> usize {
        self.gaps.len()
    }

    /// What there is to report; it then counts as reported.
    pub(super) fn take(&mut self) -> Vec<Gap> {
        std::mem::take(&mut self.gaps)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_are_told_apart_until_there_are_too_many_and_none_goes_uncounted() {
        let mut losses = Losses::default();
        for n in 0..200 {
            let at = WallTime::from_unix_nanos(n);
            losses.add(None, Some(RunId::random()), at, 2, "full".into());
        }
        assert_eq!(losses.len(), MOST);
        let gaps = losses.take();
        assert_eq!(gaps.iter().map(|gap| gap.count).sum::<u64>(), 400);
        assert_eq!(gaps[MOST - 1].to, WallTime::from_unix_nanos(199));
        assert_eq!(losses.len(), 0);
    }
}
