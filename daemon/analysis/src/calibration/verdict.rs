//! Verdict of a calibration: whether the intercepts of the fitted lines, which are the delays of an
//! empty message, agree with the clock bounds.

use peernet_clock::Verdict as DelayVerdict;
use peernet_statistics::number::{counted, error_ms, mean_std, range_ms};
use serde::Serialize;

use super::clocks::Clocks;
use super::direction::{AllowedDelays, DirectionStudy};
use crate::fit::{Estimate, Fit};

/// Kind of the verdict on the delays of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum VerdictKind {
    /// The confidence interval of each intercept overlaps the clock bounds.
    Trusted,
    /// Both ends read one clock, so the delays have no clock error.
    Exact,
    /// The confidence interval of an intercept lies outside of the clock bounds.
    Contradicted,
    /// The margin of an intercept is larger than the width of the clock bounds, so a comparison with the bounds says
    /// nothing.
    Inconclusive,
    /// A clock was stepped during the study.
    Stepped,
    /// The hosts' time daemons contradict the messages.
    Inconsistent,
    /// The two clocks were never related, or the delays of a direction have no clock bounds.
    Unsynchronised,
    /// There are too few sizes or answers to fit a line.
    Insufficient,
}

impl VerdictKind {
    /// Returns whether the study has a result. A clock step and a contradiction are results, too. Without related
    /// clocks, or without a line, the study says nothing.
    pub const fn is_result(self) -> bool {
        !matches!(self, Self::Unsynchronised | Self::Insufficient)
    }
}

/// Verdict of a study.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verdict {
    /// Kind of the verdict.
    pub kind: VerdictKind,
    /// Maximum error of the delay of a small message over this link, seconds; `None` if the delays cannot be trusted.
    #[serde(rename = "within")]
    pub max_error: Option<f64>,
    /// Verdict as a sentence.
    pub sentence: String,
}

/// Values of one direction for the comparison of its intercept with the clock bounds.
struct InterceptCheck {
    name: &'static str,
    intercept: Estimate,
    allowed: AllowedDelays,
    /// Distance from the median delay of the smallest payload to the farther of its two bounds, seconds.
    max_error: f64,
}

impl Verdict {
    /// Returns the verdict. A reason why no line or no bound can be used comes before the comparison of lines with
    /// bounds.
    pub(super) fn new(up: &DirectionStudy, down: &DirectionStudy, clocks: &Clocks) -> Self {
        let count = |verdict| up.count_verdicts(&[verdict]) + down.count_verdicts(&[verdict]);
        let without_max_error = |kind, sentence: String| Self { kind, max_error: None, sentence };
        if clocks.steps > 0 || count(DelayVerdict::Stepped) > 0 {
            let unusable_text = match count(DelayVerdict::Stepped) {
                0 => String::new(),
                stepped => format!(" ({} cannot be used)", counted(stepped, "delay")),
            };
            return without_max_error(
                VerdictKind::Stepped,
                format!(
                    "a clock was stepped or replaced during the study{unusable_text}; calibrate again when the clocks are stable"
                ),
            );
        }
        if count(DelayVerdict::Inconsistent) > 0 {
            let sentence = "the hosts' time daemons and the messages between the hosts exclude each other: one clock is wrong by more than its daemon claims, or the clocks drift apart faster than max_drift_ppm";
            return without_max_error(VerdictKind::Inconsistent, sentence.to_owned());
        }
        // `sizes` has only sizes with a known delay.
        if up.sizes.is_empty() && down.sizes.is_empty() {
            return match count(DelayVerdict::Unsynchronised) {
                0 => without_max_error(
                    VerdictKind::Insufficient,
                    "nothing was measured: no payload was answered".to_owned(),
                ),
                _ => without_max_error(
                    VerdictKind::Unsynchronised,
                    "the offset of the two clocks is unknown: no exchange related them, so no delay has a value"
                        .to_owned(),
                ),
            };
        }
        let (Some(up_fit), Some(down_fit)) = (up.main_fit(), down.main_fit()) else {
            return without_max_error(
                VerdictKind::Insufficient,
                "fewer than three sizes were answered: a line needs three".to_owned(),
            );
        };
        let intercepts = format!("{} up and {} down", with_margin(up_fit), with_margin(down_fit));
        if up.same_clock && down.same_clock {
            let sentence = format!(
                "both ends read one clock: delays are exact, and the intercepts, {intercepts}, are the delays of the link itself"
            );
            return Self { kind: VerdictKind::Exact, max_error: Some(0.0), sentence };
        }
        match (InterceptCheck::new(up, up_fit), InterceptCheck::new(down, down_fit)) {
            (Some(up), Some(down)) => Self::compare(&up, &down, &intercepts, clocks),
            _ => without_max_error(
                VerdictKind::Unsynchronised,
                format!(
                    "the delays have no bounds: nothing says how far the intercepts, {intercepts}, can be trusted"
                ),
            ),
        }
    }

    /// Adds to the sentence how often the peer went away, and that the clocks were related again. Nothing is added if
    /// the peer never went away.
    pub(super) fn with_reconnections(mut self, times: u64) -> Self {
        let times = match times {
            0 => return self,
            1 => "once".to_owned(),
            times => format!("{times} times"),
        };
        let clocks_text = match self.kind {
            // These verdicts do not depend on a clock relation.
            VerdictKind::Exact | VerdictKind::Unsynchronised | VerdictKind::Insufficient => "",
            _ => ", and the clocks were related again: each delay uses the relation at its time",
        };
        self.sentence.push_str(&format!(
            "; the peer went away {times} during the study and came back (restarted, or the network broke){clocks_text}"
        ));
        self
    }

    /// Compares the intercepts of both directions with the clock bounds.
    fn compare(up: &InterceptCheck, down: &InterceptCheck, intercepts: &str, clocks: &Clocks) -> Self {
        let allowed =
            format!("{} ms up, {} ms down", range_ms(up.allowed.at_zero), range_ms(down.allowed.at_zero));
        if up.is_imprecise() || down.is_imprecise() {
            let sentence = format!(
                "the intercepts, {intercepts}, are less certain than the clock bounds that they are compared with ({allowed}): the delay does not grow in a straight line with size over this link (see latency.png), or it needs more repeats; the bounds do not depend on this line"
            );
            return Self { kind: VerdictKind::Inconclusive, max_error: None, sentence };
        }
        let (up_distance, down_distance) = (up.distance_outside(), down.distance_outside());
        if up_distance == 0.0 && down_distance == 0.0 {
            let max_error = up.max_error.max(down.max_error);
            let sentence = format!(
                "the intercepts, {intercepts}, agree with what the clock bounds allow ({allowed}): one-way delays over this link can be trusted to ± {} ms",
                error_ms(max_error)
            );
            return Self { kind: VerdictKind::Trusted, max_error: Some(max_error), sentence };
        }
        let subject_and_verb = match (up_distance != 0.0, down_distance != 0.0) {
            (true, true) => "both lie".to_owned(),
            (true, false) => format!("the intercept of the {} lies", up.name),
            _ => format!("the intercept of the {} lies", down.name),
        };
        // A wrong offset lengthens the delays of one direction and shortens those of the other
        // direction, so the two distances have different signs.
        let reason = if up_distance * down_distance < 0.0 {
            let limit = clocks.max_drift_ppm.map_or_else(String::new, |ppm| format!(" than {ppm} ppm"));
            format!(
                "one direction is too long and the other is too short, so the clocks are at fault: they drift apart faster{limit} (max_drift_ppm), or a stamp is wrong"
            )
        } else {
            "an error of the clocks would make one direction too long and the other too short, which is not the case: the delay probably does not grow in a straight line with size over this link (see latency.png); try sizes closer together".to_owned()
        };
        let sentence = format!(
            "of the intercepts, {intercepts}, {subject_and_verb} outside what the clock bounds allow ({allowed}); {reason}"
        );
        Self { kind: VerdictKind::Contradicted, max_error: None, sentence }
    }
}

impl InterceptCheck {
    fn new(direction: &DirectionStudy, fit: &Fit) -> Option<Self> {
        let allowed = direction.allowed?;
        let median = direction.sizes.first()?.median;
        let max_error = (median - allowed.bounds.0).max(allowed.bounds.1 - median);
        Some(Self { name: direction.name(), intercept: fit.intercept, allowed, max_error })
    }

    /// Returns whether the margin of the intercept is wider than the bounds that the intercept is compared with. An
    /// intercept without a margin is imprecise, too.
    fn is_imprecise(&self) -> bool {
        let (lowest, highest) = self.allowed.at_zero;
        self.intercept.margin().is_none_or(|margin| margin > highest - lowest)
    }

    /// Returns the distance of the intercept's interval from the bounds that the clocks allow. The distance is positive
    /// if the interval lies above the bounds, negative if the interval lies below the bounds, and 0 if the interval and
    /// the bounds overlap.
    fn distance_outside(&self) -> f64 {
        let ((lo, hi), (lowest, highest)) = (self.intercept.span(), self.allowed.at_zero);
        (lo - highest).max(0.0) + (hi - lowest).min(0.0)
    }
}

/// Returns the intercept with its margin, in ms.
fn with_margin(fit: &Fit) -> String {
    format!("{} ms", mean_std(fit.intercept.value, fit.intercept.margin()))
}
