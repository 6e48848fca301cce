//! Statistics of several runs taken together.

use peernet_aggregator::{Bound, Figures, StageStatistics};
use peernet_statistics::Moments;

/// Statistics of several runs as if they were one: exact but for quantiles, which no figures of parts tell.
///
/// The median stands for itself with one run; with several it is the mean of the runs' medians by their samples, which
/// pictures need and no table shows.
pub(super) fn pooled(runs: &[Vec<StageStatistics>]) -> Vec<StageStatistics> {
    if let [only] = runs {
        return only.clone();
    }
    let mut all: Vec<StageStatistics> = Vec::new();
    for stage in runs.iter().flatten() {
        match all.iter_mut().find(|known| known.stage == stage.stage) {
            Some(known) => known.figures = together(&known.figures, &stage.figures),
            None => all.push(StageStatistics { share: None, bound: None, ..stage.clone() }),
        }
    }
    all
}

fn together(a: &Figures, b: &Figures) -> Figures {
    let mut moments = moments(a);
    moments.merge(&self::moments(b));
    let (n, m) = (a.count as f64, b.count as f64);
    Figures {
        count: moments.count,
        mean: moments.mean,
        std: moments.std(),
        min: moments.min,
        p50: (a.p50 * n + b.p50 * m) / (n + m).max(1.0),
        p95: None,
        p99: None,
        max: moments.max,
    }
}

fn moments(figures: &Figures) -> Moments {
    let Figures { count, mean, std, min, max, .. } = *figures;
    let m2 = std.map_or(0.0, |std| std * std * (count.saturating_sub(1)) as f64);
    Moments { count, mean, m2, min, max }
}

/// Verdicts of several runs, added up; the widths are those of the first run that has any.
pub(super) fn bounds(runs: &[Vec<Bound>]) -> Vec<Bound> {
    let mut all: Vec<Bound> = Vec::new();
    for bound in runs.iter().flatten() {
        let Some(known) = all.iter_mut().find(|known| known.stage == bound.stage) else {
            all.push(bound.clone());
            continue;
        };
        known.half_width = known.half_width.or(bound.half_width);
        for (verdict, count) in &bound.verdicts {
            match known.verdicts.iter_mut().find(|(one, _)| one == verdict) {
                Some((_, sum)) => *sum += count,
                None => known.verdicts.push((*verdict, *count)),
            }
        }
    }
    all
}
