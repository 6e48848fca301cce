//! Parser of chrony's state, as printed by `chronyc -c tracking`. No I/O.

use std::fmt;

use peernet_clock::{DelaySource, Interval, MonoTime, Span};

use super::claim::{Claim, FREQUENCY_TOLERANCE_PPM, SourceReport};

/// Reference id of a chronyd that follows only its own clock (`local`).
// 127.127.1.1 in hexadecimal.
const LOCAL_REFERENCE_ID: &str = "7F7F0101";
/// Default of chrony's option `maxclockerror`, parts per million. chrony widens its bound at this rate in addition to
/// the measured rates.
const DEFAULT_MAX_CLOCK_ERROR_PPM: f64 = 1.0;

/// Reason why a line is not an output of `chronyc -c tracking`.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum TrackingError {
    #[error("{0} fields instead of 14")]
    FieldCount(usize),
    #[error("{field} {text:?} is not a number")]
    NotANumber { field: &'static str, text: String },
}

/// A line of `chronyc -c tracking`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tracking {
    reference: String,
    stratum: u32,
    /// Time of chrony's latest measurement, as printed.
    pub(super) measured_at: String,
    /// Error of the clock by chrony's estimate: the reading of the clock minus true time.
    error: Span,
    /// Largest error of this estimate.
    bound: Span,
    /// Rate at which the bound grows, parts per million.
    growth_ppm: f64,
    is_synchronised: bool,
    /// `true` if chronyd follows only its own clock.
    is_local: bool,
}

impl Tracking {
    /// Parses the line: reference id, name, stratum, reference time, system time, last offset, RMS offset, frequency,
    /// residual frequency, skew, root delay, root dispersion, update interval, leap status (chronyc(1), `tracking`).
    pub(super) fn parse(line: &str) -> Result<Self, TrackingError> {
        let fields: Vec<&str> = line.trim().split(',').collect();
        let [
            id,
            name,
            stratum,
            measured_at,
            system_time,
            _,
            _,
            _,
            residual,
            skew,
            delay,
            dispersion,
            _,
            leap,
        ] = fields[..]
        else {
            return Err(TrackingError::FieldCount(fields.len()));
        };
        let invalid = |field, text: &str| TrackingError::NotANumber { field, text: text.to_owned() };
        let number = |field, text: &str| {
            let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
            value.ok_or_else(|| invalid(field, text))
        };
        let (delay, dispersion) = (number("root delay", delay)?, number("root dispersion", dispersion)?);
        let growth = number("skew", skew)?.abs() + number("residual frequency", residual)?.abs();
        Ok(Self {
            reference: if name.is_empty() { id } else { name }.to_owned(),
            stratum: stratum.parse().map_err(|_| invalid("stratum", stratum))?,
            measured_at: measured_at.to_owned(),
            // Positive means "slow of NTP time": the clock's reading is less than true time.
            error: -Span::from_seconds_f64(number("system time", system_time)?),
            bound: Span::from_seconds_f64(dispersion.abs() + delay.abs() / 2.0),
            // At least the rate that NTP assumes.
            growth_ppm: (growth + DEFAULT_MAX_CLOCK_ERROR_PPM).max(FREQUENCY_TOLERANCE_PPM),
            is_synchronised: leap != "Not synchronised",
            is_local: id == LOCAL_REFERENCE_ID,
        })
    }

    /// Returns the report of a line that was read at `at`.
    ///
    /// The documented bound of the clock's error is `|system time| + root dispersion + root delay / 2`. The sign of the
    /// system time is known, and chrony slews the clock until the system time is zero. Therefore the interval spans
    /// from the estimate to zero, extended by the other two terms at both ends.
    pub(super) fn to_report(&self, at: MonoTime) -> SourceReport {
        let claim = (self.is_synchronised && !self.is_local).then(|| Claim {
            at,
            error: Interval {
                lo: self.error.min(Span::ZERO) - self.bound,
                hi: self.error.max(Span::ZERO) + self.bound,
            },
            growth_ppm: self.growth_ppm,
        });
        let text = match self {
            Self { is_synchronised: false, .. } => "chrony, not synchronised".to_owned(),
            Self { is_local: true, .. } => "chrony, local reference only".to_owned(),
            Self { stratum, reference, .. } => format!("chrony, stratum {stratum}, to {reference}"),
        };
        SourceReport { source: DelaySource::Chrony, claim, text }
    }
}

/// Returns a report of chrony without a claim, with the reason.
pub(super) fn report_without_claim(reason: &impl fmt::Display) -> SourceReport {
    SourceReport { source: DelaySource::Chrony, claim: None, text: format!("chrony, {reason}") }
}

/// Decides whether chrony's answers are current. After a step of the clock chrony repeats its last measurement until it
/// measures again.
#[derive(Debug, Default)]
pub(super) struct AnswerFreshness {
    epoch: u32,
    state: AnswerState,
}

/// State of chrony's answers after the last step of the clock.
#[derive(Debug, Default)]
enum AnswerState {
    /// The answers are current.
    #[default]
    Current,
    /// chrony has not answered since the step.
    Stepped,
    /// chrony repeats a measurement that it may have made before the step. The value is the time of this measurement.
    Repeating(String),
}

impl AnswerFreshness {
    /// Creates a state in which answers are current as long as the clock's epoch is `epoch`.
    pub(super) const fn new(epoch: u32) -> Self {
        Self { epoch, state: AnswerState::Current }
    }

    /// Returns whether `tracking` was measured after the last step of the clock. `epoch` is the epoch of the clock,
    /// read after `tracking`.
    pub(super) fn accepts(&mut self, tracking: &Tracking, epoch: u32) -> bool {
        if self.epoch != epoch {
            self.epoch = epoch;
            self.state = AnswerState::Stepped;
        }
        match &self.state {
            AnswerState::Current => true,
            AnswerState::Repeating(measured_at) if *measured_at != tracking.measured_at => {
                self.state = AnswerState::Current;
                true
            }
            AnswerState::Repeating(_) => false,
            // Nothing shows whether chrony made this measurement before or after the step, so a newer one is awaited.
            AnswerState::Stepped => {
                self.state = AnswerState::Repeating(tracking.measured_at.clone());
                false
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Output of chronyc 4.3.
    const SLOW_CLOCK: &str = "7F000001,127.0.0.1,11,1795179452.504467807,0.049999367,0.000000412,0.000000412,-1.446,0.001,10.048,0.000005846,0.000007896,0.3,Normal\n";
    const OWN_CLOCK: &str = "7F7F0101,,10,1795179451.641823310,0.000000000,0.000000000,0.000000000,0.000,0.000,0.000,0.000000000,0.000000000,0.0,Normal\n";
    const NOT_SYNCHRONISED: &str = "00000000,,0,0.000000000,0.000000000,0.000000000,0.000000000,0.000,0.000,0.000,1.000000000,1.000000000,0.0,Not synchronised\n";

    fn report(line: &str) -> SourceReport {
        Tracking::parse(line).expect("chronyc printed it").to_report(MonoTime::from_nanos(0))
    }

    #[test]
    fn slow_clock_has_negative_error() {
        let report = report(SLOW_CLOCK);
        assert_eq!(report.text, "chrony, stratum 11, to 127.0.0.1");
        let claim = report.claim.expect("chrony was synchronised");
        let bound = Span::from_nanos(7896 + 5846 / 2);
        assert_eq!(claim.error, Interval { lo: Span::from_nanos(-49_999_367) - bound, hi: bound });
        assert!((claim.growth_ppm - FREQUENCY_TOLERANCE_PPM).abs() < 1e-9, "{}", claim.growth_ppm);
    }

    #[test]
    fn fast_clock_has_positive_error_that_grows_with_skew() {
        let line = "50505300,PPS,1,1795179452.5,-0.002,0,0,0,-4.0,30.0,0.001,0.0005,16.0,Normal";
        let claim = report(line).claim.expect("chrony was synchronised");
        assert_eq!(claim.error, Interval { lo: Span::from_millis(-1), hi: Span::from_millis(3) });
        assert!((claim.growth_ppm - 35.0).abs() < 1e-9, "{}", claim.growth_ppm);
    }

    #[test]
    fn unsynchronised_chrony_claims_nothing() {
        for (line, text) in [(NOT_SYNCHRONISED, "not synchronised"), (OWN_CLOCK, "local reference")] {
            let report = report(line);
            assert_eq!(report.claim, None);
            assert!(report.text.contains(text), "{}", report.text);
        }
    }

    #[test]
    fn invalid_tracking_report_is_refused_with_reason() {
        for line in ["", "506 Cannot talk to daemon", "a,b,c", &SLOW_CLOCK.replace("0.000005846", "nan")] {
            assert!(Tracking::parse(line).is_err(), "{line}");
        }
        let error =
            Tracking::parse(&SLOW_CLOCK.replace("0.049999367", "slow")).expect_err("a field is not a number");
        assert_eq!(error.to_string(), "system time \"slow\" is not a number");
    }

    #[test]
    fn measurements_before_step_are_not_accepted() {
        let old_answer = Tracking::parse(SLOW_CLOCK).expect("chronyc printed it");
        let new_answer = Tracking { measured_at: "1795179453.193074185".to_owned(), ..old_answer.clone() };
        let mut answer_freshness = AnswerFreshness::new(0);
        assert!(answer_freshness.accepts(&old_answer, 0));
        assert!(!answer_freshness.accepts(&old_answer, 1), "the clock was stepped");
        assert!(!answer_freshness.accepts(&old_answer, 1));
        assert!(answer_freshness.accepts(&new_answer, 1));
        assert!(answer_freshness.accepts(&new_answer, 1));
    }
}
