//! Warnings of the overview: latencies with a large spread, busy processors, unattributed time, skipped and late
//! starts.

use peernet_aggregator::{HostSnapshot, MetricsPoint, Window};
use peernet_analysis::rows::SKIPPED_STARTS;
use peernet_analysis::stage_split::StageSplit;
use peernet_analysis::trust::Starts;
use peernet_clock::{Span, WallTime};
use peernet_logger::stage;
use peernet_statistics::number::{SPACE, duration, percent, times};
use peernet_store::QuantityStatistics;

use super::chip::{Chip, Tone};
use super::events::Remark;
use super::stack::Stack;
use crate::config::WarnConfig;

/// Minimum time for which the processors must have been busy.
const MIN_BUSY_TIME: Span = Span::from_seconds(10);

/// Returns a warning if a host's processors have been busy for ten seconds.
pub(crate) fn host_warning(host: &HostSnapshot, now: WallTime, warn: &WarnConfig) -> Option<Remark> {
    let limit = warn.cpu_percent / 100.0;
    let current = host.metrics.cpu.filter(|_| host.connected)?;
    // Checks all points of the last `MIN_BUSY_TIME`, and the newest point before them, so that the points cover the
    // whole time.
    let mut points = host.history.iter().rev();
    let mut lowest = current;
    loop {
        let MetricsPoint { at, metrics } = &**points.next()?;
        lowest = lowest.min(metrics.cpu?);
        if now - *at >= MIN_BUSY_TIME {
            break;
        }
    }
    let text = || {
        format!(
            "the processors have been busy for 10{SPACE}s, never below {}{SPACE}%: latencies contain waiting.",
            percent(lowest)
        )
    };
    (lowest > limit).then(|| Remark { chip: Chip::new(Tone::Warn, "remark", "busy"), text: text() })
}

/// Returns the warnings about a pipeline's last minute: for each a chip, and the rest of a sentence about the pipeline.
pub(crate) fn pipeline_warnings(minute: &Window, warn: &WarnConfig) -> Vec<(Chip, String)> {
    let split = Stack::of_window(minute).split;
    [
        tail_warning(minute, warn),
        unattributed_warning(&split, warn),
        skipped_warning(minute, warn),
        late_warning(&split, warn),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// Returns the warning about a p99 that is much larger than the median.
fn tail_warning(minute: &Window, warn: &WarnConfig) -> Option<(Chip, String)> {
    let total = minute.value(&stage::TOTAL)?;
    let p99 = total.p99.filter(|p99| *p99 > warn.p99_over_median * total.p50)?;
    let text = format!(
        "has a p99 of {} in the last minute, {} the median of {}.",
        duration(p99),
        times(p99 / total.p50),
        duration(total.p50)
    );
    Some((Chip::new(Tone::Warn, "slow", "tail"), text))
}

/// Returns the warning about time that no stage, lateness or restart explains, or about stages that overlap. The trust
/// report has the same rule.
fn unattributed_warning(split: &StageSplit, warn: &WarnConfig) -> Option<(Chip, String)> {
    let seconds = split.unexplained()?;
    split.is_notable(seconds, warn.unattributed_percent / 100.0).then_some(())?;
    let share = percent(split.share_of_mean_total(seconds.abs()));
    if seconds < 0.0 {
        let text = format!(
            "has stages that overlap: their sum exceeds the total by {share}{SPACE}% in the last minute."
        );
        return Some((Chip::new(Tone::Warn, "inconsistent", "sum"), text));
    }
    let text = format!(
        "has {} per iteration in no stage, {share}{SPACE}% of its total in the last minute.",
        duration(seconds)
    );
    Some((Chip::new(Tone::Warn, "unknown", "unattributed"), text))
}

/// Returns the warning about starts that the pipeline skipped.
fn skipped_warning(minute: &Window, warn: &WarnConfig) -> Option<(Chip, String)> {
    let skipped = minute.value(SKIPPED_STARTS).map_or(0.0, QuantityStatistics::sum);
    let started = minute.counts.total();
    let starts = Starts { started, skipped: skipped.round() as u64, ..Starts::default() };
    let text = format!("skipped {} in the last minute: it does not keep its rate.", starts.skipped_text()?);
    (starts.skipped_share() > warn.skipped_percent / 100.0)
        .then_some((Chip::new(Tone::Warn, "gap", "skipped"), text))
}

/// Returns the warning about iterations that start later than intended.
fn late_warning(split: &StageSplit, warn: &WarnConfig) -> Option<(Chip, String)> {
    let seconds = split.lateness.filter(|seconds| split.is_notable(*seconds, warn.late_percent / 100.0))?;
    let text = format!(
        "starts {} late on average, {}{SPACE}% of its total in the last minute.",
        duration(seconds),
        percent(split.share_of_mean_total(seconds))
    );
    Some((Chip::new(Tone::Warn, "slow", "late"), text))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_analysis::rows::LATENESS;
    use peernet_clock::Verdict;
    use peernet_logger::Name;

    use super::*;
    use crate::tests::samples::{self, NOW, figures};

    /// Returns the words of the warnings about a minute that `change` has changed.
    fn words(change: impl FnOnce(&mut Window)) -> Vec<&'static str> {
        let mut minute = samples::window(60, 30.0, 1.0, Verdict::Ok);
        change(&mut minute);
        pipeline_warnings(&minute, &WarnConfig::default()).into_iter().map(|(chip, _)| chip.word).collect()
    }

    fn set(minute: &mut Window, name: &str, mean: f64) {
        minute.values.retain(|(node, _)| node != name);
        minute.values.push((Name::from(name.to_owned()), figures(mean, minute.counts.ok)));
    }

    fn total(minute: &mut Window) -> &mut peernet_store::QuantityStatistics {
        minute
            .values
            .iter_mut()
            .find(|(name, _)| *name == stage::TOTAL)
            .map(|(_, total)| total)
            .expect("there")
    }

    #[test]
    fn large_p99_over_median_causes_warning() {
        assert_eq!(words(|_| ()), [] as [&str; 0]);
        let with_p99 = |p99| words(move |minute| (total(minute).p50, total(minute).p99) = (0.018, p99));
        assert_eq!(with_p99(Some(0.311)), ["tail"], "17 times the median");
        assert_eq!(with_p99(Some(0.085)), [] as [&str; 0]);
        assert_eq!(with_p99(None), [] as [&str; 0], "too few iterations for a p99");
    }

    #[test]
    fn unattributed_time_without_lateness_causes_warning() {
        let set_unattributed = |minute: &mut Window, seconds| {
            let stages = stage::ORDER;
            let sum: f64 = stages.iter().filter_map(|name| minute.value(name)).map(|stage| stage.mean).sum();
            (total(minute).mean, total(minute).p99) = (sum + seconds, None);
            set(minute, &stage::UNATTRIBUTED, seconds);
        };
        assert_eq!(words(|minute| set_unattributed(minute, 0.0020)), ["unattributed"]);
        assert_eq!(words(|minute| set_unattributed(minute, 0.0008)), [] as [&str; 0]);
        let late = |minute: &mut Window| {
            set_unattributed(minute, 0.0025);
            set(minute, LATENESS, 0.0024);
        };
        assert_eq!(words(late), ["late"]);
        let restarted = |minute: &mut Window| {
            set_unattributed(minute, 0.0025);
            set(minute, &stage::RESTART, 0.0024);
        };
        assert_eq!(words(restarted), [] as [&str; 0], "the wait for a restart is explained");
        assert_eq!(words(|minute| set_unattributed(minute, -0.0025)), ["sum"]);
        let without_unattributed = |minute: &mut Window| {
            set_unattributed(minute, 0.0080);
            minute.values.retain(|(name, _)| *name != stage::UNATTRIBUTED);
        };
        assert_eq!(words(without_unattributed), [] as [&str; 0], "the stages are not all known");
    }

    #[test]
    fn skipped_starts_cause_warning() {
        assert_eq!(words(|minute| set(minute, SKIPPED_STARTS, 0.0)), [] as [&str; 0]);
        assert_eq!(words(|minute| set(minute, SKIPPED_STARTS, 0.01)), ["skipped"]);
        let tolerant = WarnConfig { skipped_percent: 2.0, ..WarnConfig::default() };
        let mut minute = samples::window(60, 30.0, 1.0, Verdict::Ok);
        set(&mut minute, SKIPPED_STARTS, 0.01);
        assert_eq!(pipeline_warnings(&minute, &tolerant), []);
        let text = &pipeline_warnings(&minute, &WarnConfig::default())[0].1;
        assert!(text.starts_with("skipped 18 of "), "{text}");
    }

    #[test]
    fn processors_busy_for_ten_seconds_cause_warning() {
        // Busy shares now, five seconds ago, ten seconds ago and so on.
        let busy = |shares: &[f64]| {
            let mut host = samples::host("cam-1", "Orin");
            let metrics = |share| peernet_stream::HostMetrics { cpu: Some(share), ..host.metrics.clone() };
            let points = shares[1..].iter().enumerate().rev().map(|(index, share)| {
                let at = NOW - Span::from_seconds(5 * (index as i64 + 1));
                Arc::new(MetricsPoint { at, metrics: metrics(*share) })
            });
            host.history = points.collect();
            host.metrics = metrics(shares[0]);
            host_warning(&host, NOW, &WarnConfig::default()).map(|remark| remark.text)
        };
        assert!(busy(&[0.97, 0.95, 0.94]).is_some_and(|text| text.contains("94")));
        assert_eq!(busy(&[0.97, 0.95]), None, "for five seconds only");
        assert_eq!(busy(&[0.97, 0.80, 0.94]), None);
        assert_eq!(busy(&[0.80, 0.95, 0.94]), None);
    }
}
