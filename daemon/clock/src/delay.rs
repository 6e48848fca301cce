//! The one-way delay between two hosts: the raw difference of the stamps, the corrected value with an interval, and a
//! verdict on the value.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::Span;

/// A closed interval of spans.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Interval {
    /// Lower end.
    pub lo: Span,
    /// Upper end; not below `lo`.
    pub hi: Span,
}

impl Interval {
    /// Returns the interval that contains one value only.
    pub const fn exactly(value: Span) -> Self {
        Self { lo: value, hi: value }
    }

    /// Returns the upper end minus the lower end.
    pub fn width(self) -> Span {
        self.hi - self.lo
    }

    /// Returns whether the interval of a delay is wider than half the delay. The verdict of such a
    /// delay is [`Verdict::Limited`] or worse.
    pub fn is_wide_for(self, delay: Span) -> bool {
        self.width() > Span::from_nanos(delay.abs().nanos() / 2)
    }

    /// Returns the value halfway between the ends, rounded down.
    pub const fn middle(self) -> Span {
        let (lo, hi) = (self.lo.nanos(), self.hi.nanos());
        // The sum of both ends could overflow.
        Span::from_nanos((lo & hi) + ((lo ^ hi) >> 1))
    }

    /// Returns whether `span` lies between the ends or on one of them.
    pub fn contains(self, span: Span) -> bool {
        self.lo <= span && span <= self.hi
    }

    /// Returns the common part of two intervals; `None` if they do not overlap.
    pub fn intersection(self, other: Self) -> Option<Self> {
        let common = Self { lo: self.lo.max(other.lo), hi: self.hi.min(other.hi) };
        (common.lo <= common.hi).then_some(common)
    }

    /// Returns the smallest interval that contains both intervals.
    pub fn hull(self, other: Self) -> Self {
        Self { lo: self.lo.min(other.lo), hi: self.hi.max(other.hi) }
    }
}

/// Source of the offset by which a delay was corrected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DelaySource {
    /// Proof that both hosts read one clock.
    SameClock,
    /// The band of offsets that the exchanges between the two hosts prove.
    InBand,
    /// The error bounds that the kernels state.
    Kernel,
    /// The error bounds that chrony states.
    Chrony,
    /// Several of the sources above: the offset lies in the intersection of their intervals.
    Intersection,
    /// No source: the clocks were never related.
    None,
}

impl DelaySource {
    /// Returns whether the source is a claim of time daemons or kernels.
    pub const fn is_claim(self) -> bool {
        matches!(self, Self::Kernel | Self::Chrony)
    }

    /// Returns whether such claims determine an end of the interval.
    pub const fn uses_claims(self) -> bool {
        self.is_claim() || matches!(self, Self::Intersection)
    }
}

/// At least one delay in this many must have the summary verdict or a worse verdict.
const MIN_SHARE_RECIPROCAL: u64 = 20;

/// Degree to which a delay can be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// The interval contains the true delay and is at most half as wide as the delay.
    Ok,
    /// The interval contains the true delay but is wider than half of the delay, or a jump of a clock was suspected
    /// before the delay, by at most the length of the window ([`window`](crate::RelationSettings::window)).
    Limited,
    /// There are no recent exchanges, or too few; or the newest exchanges contradict the others, and neither of the two
    /// groups is refuted yet.
    Stale,
    /// The two clocks were never related, or no exchange bounds the offset at the time of the delay.
    Unsynchronised,
    /// A clock was stepped near this delay.
    Stepped,
    /// Two sources exclude each other, or exchanges contradict each other. There is neither a value nor an interval.
    Inconsistent,
}

impl Verdict {
    /// Returns the rank of the verdict: 0 for the best one.
    pub const fn severity(self) -> u8 {
        match self {
            Self::Ok => 0,
            Self::Limited => 1,
            Self::Stale => 2,
            Self::Stepped => 3,
            Self::Inconsistent => 4,
            Self::Unsynchronised => 5,
        }
    }

    /// Returns the worst of some verdicts; `None` without verdicts.
    pub fn worst(verdicts: impl IntoIterator<Item = Self>) -> Option<Self> {
        verdicts.into_iter().max_by_key(|verdict| verdict.severity())
    }

    /// Returns the summary verdict of many delays, which is the 95th percentile of their verdicts from the best to the
    /// worst: at least a twentieth of the delays have this verdict or a worse verdict. `counts` has the number of delays
    /// for each verdict. `None` without delays.
    // A few bad delays must not hide that all others are good, and many bad delays must not be hidden by good ones.
    pub fn summarise(counts: impl IntoIterator<Item = (Self, u64)>) -> Option<Self> {
        let mut counts: Vec<(Self, u64)> = counts.into_iter().filter(|(_, count)| *count > 0).collect();
        let total: u64 = counts.iter().map(|(_, count)| count).sum();
        counts.sort_by_key(|(verdict, _)| std::cmp::Reverse(verdict.severity()));
        let mut worse_or_equal = 0_u64;
        let summary_verdict = counts.into_iter().find(|(_, count)| {
            worse_or_equal += count;
            worse_or_equal.saturating_mul(MIN_SHARE_RECIPROCAL) >= total
        });
        summary_verdict.map(|(verdict, _)| verdict)
    }
}

macro_rules! names {
    ($type:ident { $($variant:ident = $name:literal),* $(,)? }) => {
        impl $type {
            /// All values, in the order of declaration.
            pub const ALL: &'static [Self] = &[$(Self::$variant),*];

            /// Returns the name used in storage, in the API and on the pages.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),* }
            }

            /// Returns the value with a name; `None` for an unknown name.
            pub fn from_name(name: &str) -> Option<Self> {
                Self::ALL.iter().copied().find(|value| value.name() == name)
            }
        }

        impl fmt::Display for $type {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(self.name())
            }
        }
    };
}

names!(DelaySource {
    SameClock = "same-clock",
    InBand = "in-band",
    Kernel = "kernel",
    Chrony = "chrony",
    Intersection = "intersection",
    None = "none",
});

names!(Verdict {
    Ok = "ok",
    Limited = "limited",
    Stale = "stale",
    Unsynchronised = "unsynchronised",
    Stepped = "stepped",
    Inconsistent = "inconsistent",
});

/// The delay of one message from one host to another, or the difference between the times at which two receivers got
/// the same message ([`Relation::reception_differences`](crate::Relation::reception_differences)).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OneWayDelay {
    /// Receive stamp minus send stamp, each from its own host's clock. May be negative, because it contains the offset
    /// of the clocks.
    // It is always present, so that the correction can be computed again.
    pub raw: Span,
    /// Estimate; `None` if the verdict is `unsynchronised`, `stepped` or `inconsistent`. A delay is never negative; a
    /// difference between two receivers may be.
    pub value: Option<Span>,
    /// Interval that contains the true delay as long as the clocks stay within the configured limits of drift.
    pub bounds: Option<Interval>,
    /// Source of the offset that `value` and `bounds` follow from.
    pub source: DelaySource,
    /// Degree to which `value` and `bounds` can be trusted.
    pub verdict: Verdict,
}

impl OneWayDelay {
    /// Returns half the width of the bounds in seconds: the ± of the delay. `None` if the delay has no bounds or no
    /// value. Statistics do not include a delay without a value.
    pub fn half_width(&self) -> Option<f64> {
        self.value?;
        // The ends are stored in seconds. The result is computed from them and not from the nanoseconds, so that
        // statistics that are rebuilt from the store have equal numbers.
        self.bounds.map(|bounds| (bounds.hi.seconds() - bounds.lo.seconds()) / 2.0)
    }

    /// Returns the delay in seconds. `None` if the verdict says that the delay is not known, for example because a
    /// clock was stepped.
    pub fn known_seconds(&self) -> Option<f64> {
        // The verdict is checked, because deserialisation does not check that a delay with a bad verdict has no value.
        let is_known = matches!(self.verdict, Verdict::Ok | Verdict::Limited | Verdict::Stale);
        self.value.filter(|_| is_known).map(Span::seconds)
    }

    /// Returns the offset of the receiver's wall clock from the sender's that was subtracted from `raw` to give `value`;
    /// positive if the receiver's clock is ahead. `None` if the delay is not known.
    pub fn clock_offset(&self) -> Option<Span> {
        self.known_seconds()?;
        Some(self.raw - self.value?)
    }

    /// Returns the ends of the interval in seconds; `None` if the delay is not known or has no interval.
    pub fn known_bounds(&self) -> Option<(f64, f64)> {
        self.known_seconds()?;
        self.bounds.map(|bounds| (bounds.lo.seconds(), bounds.hi.seconds()))
    }

    /// Creates a delay between two hosts whose clocks were never related. It has the raw difference only.
    pub const fn unsynchronised(raw: Span) -> Self {
        Self { raw, value: None, bounds: None, source: DelaySource::None, verdict: Verdict::Unsynchronised }
    }

    /// Creates a delay with a stamp near a step of its clock. It has the raw difference only.
    pub const fn stepped(raw: Span, source: DelaySource) -> Self {
        Self { raw, value: None, bounds: None, source, verdict: Verdict::Stepped }
    }

    /// Creates a delay between two stamps of one clock.
    ///
    /// A negative difference means that a wall clock was set back between the two stamps; the delay is then `stepped`.
    pub const fn same_clock(raw: Span) -> Self {
        if raw.is_negative() {
            return Self::stepped(raw, DelaySource::SameClock);
        }
        Self {
            raw,
            value: Some(raw),
            bounds: Some(Interval::exactly(raw)),
            source: DelaySource::SameClock,
            verdict: Verdict::Ok,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn summary_verdict_ignores_few_bad_delays() {
        let verdict_with = |bad: u64| Verdict::summarise([(Verdict::Ok, 100 - bad), (Verdict::Stepped, bad)]);
        assert_eq!(
            (verdict_with(4), verdict_with(5), Verdict::summarise([])),
            (Some(Verdict::Ok), Some(Verdict::Stepped), None)
        );
        let counts = [(Verdict::Ok, 94), (Verdict::Stale, 3), (Verdict::Inconsistent, 3)];
        assert_eq!(
            Verdict::summarise(counts),
            Some(Verdict::Stale),
            "six of a hundred delays are stale or worse, which is more than a twentieth"
        );
    }

    #[test]
    fn negative_difference_is_not_a_delay() {
        let delay = OneWayDelay::same_clock(Span::from_nanos(-1));
        assert_eq!((delay.value, delay.bounds, delay.verdict), (None, None, Verdict::Stepped));
        assert_eq!(delay.raw, Span::from_nanos(-1));
    }

    #[test]
    fn names_round_trip_and_match_serialised_form() {
        for verdict in Verdict::ALL {
            assert_eq!(Verdict::from_name(verdict.name()), Some(*verdict));
            assert_eq!(serde_json::to_string(verdict).expect("serialises"), format!("\"{verdict}\""));
        }
        for source in DelaySource::ALL {
            assert_eq!(DelaySource::from_name(source.name()), Some(*source));
            assert_eq!(serde_json::to_string(source).expect("serialises"), format!("\"{source}\""));
        }
    }
}
