//! Judgement of the total over time: trend, beginning and outliers. Also judgement of the time outside of all stages.

use peernet_statistics::number::{counted, fixed, significant};
use peernet_stream::Grade;

use super::{finding, ms, percent, with_advice};
use crate::stage_split::{NOTABLE_UNEXPLAINED_SHARE, StageSplit};
use crate::trust::time_series::{MIN_NOTABLE_CHANGE, relative_change};
use crate::trust::trend::chance_of_trend;
use crate::trust::{Finding, TimeSeries, TrustInput};

/// If the median changes by at least this share from the first half to the second, the finding is bad, because one
/// number for the whole run is meaningless.
const STRONG_DRIFT: f64 = 0.2;
/// If the relative change of the median is below this value, the medians of both halves are printed as one number.
const MIN_VISIBLE_CHANGE: f64 = 0.000_5;
/// Significance level: a trend is attributed to chance if chance alone causes such a trend with at least this
/// probability.
const MAX_CHANCE: f64 = 0.05;
/// The finding about the warm-up can be doubtful only if the first iterations take longer than the rest by more than
/// this share.
const MAX_COLD_EXCESS: f64 = 0.1;
/// The finding about outliers is doubtful if they contribute at least this share of the mean, and the finding about
/// restarts if they took at least this share of the time: a long restart is an outlier.
pub(super) const MAX_INFLUENCE: f64 = 0.05;
/// The finding about unattributed time is bad if at least this share of the total lies outside of all stages.
const BAD_UNATTRIBUTED_SHARE: f64 = 0.25;
/// Minimum number of iterations that can be judged over time.
const MIN_ITERATIONS: u64 = 100;
/// Minimum number of later blocks that the first block can be compared with. A run of [`MIN_ITERATIONS`] has five
/// blocks of 20 iterations.
const MIN_LATER_BLOCKS: usize = 4;

pub(super) fn findings(input: &TrustInput) -> Vec<Finding> {
    let Some(total) = &input.total else { return Vec::new() };
    let mut findings =
        vec![judge_stationarity(total, &input.stages), judge_warm_up(total), judge_outliers(total)];
    findings.extend(judge_unattributed(&input.split));
    findings.extend(input.split.lateness.map(|seconds| judge_lateness(seconds, &input.split)));
    findings
}

/// Returns the sentence that says what is unknown about a run, and why. `whether` is the clause after "whether":
/// `the run drifted`.
///
/// A run with enough iterations can have too few time buckets. The dashboard's buckets last a second or longer. After
/// the clock was set forward, the run seems so long that its buckets are wide, and few of them contain iterations.
fn unknown_text(total: &TimeSeries, whether: &str) -> String {
    if total.count < MIN_ITERATIONS {
        return format!(
            "The run is too short to tell whether {whether}: at least {MIN_ITERATIONS} iterations are needed."
        );
    }
    format!(
        "It is unknown whether {whether}: the run's {} lie in too few time buckets. The run lasted only seconds, \
         or its clock was set meanwhile.",
        counted(total.count, "iteration")
    )
}

fn judge_stationarity(total: &TimeSeries, stages: &[(String, TimeSeries)]) -> Finding {
    let about = "stationarity";
    let statistics = total.halves.zip(total.change()).zip(chance_of_trend(&total.batches));
    let Some((((first, second), change), chance)) = statistics else {
        return finding(about, Grade::Unknown, unknown_text(total, "the run drifted"));
    };
    let change_size = change.abs();
    let change_text = format!(
        "The median of the second half is {} {} than the median of the first half ({} and {})",
        percent(change_size),
        if change < 0.0 { "lower" } else { "higher" },
        ms(second),
        ms(first)
    );
    if change_size < MIN_VISIBLE_CHANGE {
        let text = format!("The medians of both halves are the same, {}: the run did not drift.", ms(first));
        return finding(about, Grade::Good, text);
    }
    if !total.has_notable_change() {
        let text =
            format!("{change_text}, less than {}: the run did not drift.", percent(MIN_NOTABLE_CHANGE));
        return finding(about, Grade::Good, text);
    }
    let p_value = match chance {
        p if p < 0.001 => "p\u{202f}<\u{202f}0.001".to_owned(),
        p => format!("p\u{202f}=\u{202f}{}", significant(p)),
    };
    if chance >= MAX_CHANCE {
        return finding(
            about,
            Grade::Good,
            format!("{change_text}, which is not more than chance ({p_value})."),
        );
    }
    let stage_halves = stages.iter().filter_map(|(name, stage)| Some((name, stage.halves?)));
    let most_changed = stage_halves.max_by(|(_, a), (_, b)| (a.1 - a.0).abs().total_cmp(&(b.1 - b.0).abs()));
    let stage_text = most_changed.map_or_else(String::new, |(name, (first, second))| {
        format!("; `{name}` changed most ({} to {})", ms(first), ms(second))
    });
    let text = format!("{change_text}, more than chance ({p_value}){stage_text}.");
    let advice = "one number for the whole run hides this change: find out what changed (heat, load, network), or measure \
                  longer and after the change has ended";
    with_advice(
        finding(about, if change_size >= STRONG_DRIFT { Grade::Bad } else { Grade::Doubtful }, text),
        advice,
    )
}

fn judge_warm_up(total: &TimeSeries) -> Finding {
    let about = "warm-up";
    let Some(beginning) = total.beginning.filter(|beginning| beginning.later_block_count >= MIN_LATER_BLOCKS)
    else {
        return finding(about, Grade::Unknown, unknown_text(total, "the warm-up was long enough"));
    };
    let excess = relative_change(beginning.rest, beginning.median);
    let comparison = format!(
        "The first {} measured iterations took {} in the median, the rest {}",
        beginning.count,
        ms(beginning.median),
        ms(beginning.rest)
    );
    // If nothing distinguishes the first block, each rank among all blocks is equally probable for it. `share_as_high`
    // is then about the probability that the first block has such a high rank by chance.
    if excess > MAX_COLD_EXCESS && beginning.share_as_high < MAX_CHANCE {
        let text = format!(
            "{comparison}: {} more. Nearly all later groups of {} took less.",
            percent(excess),
            counted(beginning.count, "iteration")
        );
        return with_advice(
            finding(about, Grade::Doubtful, text),
            "make the warm-up longer, so that it includes these iterations",
        );
    }
    if excess > MAX_COLD_EXCESS {
        let blocks_as_high = (beginning.share_as_high * beginning.later_block_count as f64).round();
        let text = format!(
            "{comparison}. Of {} later groups of {}, {} took as long or longer, so this is not more than chance: the \
             warm-up was long enough.",
            beginning.later_block_count,
            counted(beginning.count, "iteration"),
            fixed(blocks_as_high, 0)
        );
        return finding(about, Grade::Good, text);
    }
    finding(about, Grade::Good, format!("{comparison}: the warm-up was long enough."))
}

fn judge_outliers(total: &TimeSeries) -> Finding {
    let about = "outliers";
    let outliers = &total.outliers;
    if outliers.count == 0 {
        return finding(
            about,
            Grade::Good,
            format!("No outliers: the slowest iteration took {}.", ms(outliers.max)),
        );
    }
    let influence = if total.mean > 0.0 { outliers.influence / total.mean } else { 0.0 };
    let text = format!(
        "{} of the iterations took longer than {} (median plus 3.5 robust standard deviations); the slowest took {}, {} \
         times the median. They contribute {} of the mean.",
        percent(outliers.count as f64 / total.count as f64),
        ms(outliers.limit),
        ms(outliers.max),
        fixed(if total.median > 0.0 { outliers.max / total.median } else { 0.0 }, 1),
        percent(influence)
    );
    if influence < MAX_INFLUENCE {
        return finding(about, Grade::Good, text);
    }
    let advice =
        "report median, 95th and 99th percentile beside mean ± std, and look at the slowest iterations";
    with_advice(finding(about, Grade::Doubtful, text), advice)
}

/// Returns the finding about the time outside of all stages. Lateness and the wait for the restart of the model's
/// process are subtracted from this time: both are measured and have separate findings, although they are not stages.
/// `None` if the stages are not known.
fn judge_unattributed(split: &StageSplit) -> Option<Finding> {
    let about = "unattributed";
    let seconds = split.unexplained()?;
    let exclusion = match (split.lateness.is_some(), split.model_restarts > 0.0) {
        (true, true) => ", late starts and restarts excluded",
        (true, false) => ", late starts excluded",
        (false, true) => ", restarts excluded",
        (false, false) => "",
    };
    let share = split.share_of_mean_total(seconds.abs());
    let text = if seconds < 0.0 {
        format!(
            "The stages add up to {} more than the total{exclusion}: some stages overlap.",
            percent(share)
        )
    } else {
        format!(
            "{} of the total belongs to no stage{exclusion} ({} on average).",
            percent(share),
            ms(seconds)
        )
    };
    if !split.is_notable(seconds, NOTABLE_UNEXPLAINED_SHARE) {
        return Some(finding(about, Grade::Good, text));
    }
    let advice = "publish the measured total, not the sum of the stages; the columns of data.csv, and an iteration's waterfall on the dashboard, show the remaining time";
    let grade = if share >= BAD_UNATTRIBUTED_SHARE { Grade::Bad } else { Grade::Doubtful };
    Some(with_advice(finding(about, grade, text), advice))
}

/// Returns the finding about lateness, the time for which iterations waited for earlier iterations. The finding is
/// always good, because lateness is a measured part of the total and not a defect.
fn judge_lateness(seconds: f64, split: &StageSplit) -> Finding {
    let text = format!(
        "Iterations began {} after their intended start on average: this late start is {} of the total.",
        ms(seconds),
        percent(split.share_of_mean_total(seconds))
    );
    finding("late start", Grade::Good, text)
}
