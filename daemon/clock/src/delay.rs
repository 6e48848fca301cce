//! A one-way delay between two hosts: what was stamped, what is known, and how well.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::Span;

/// A closed interval of spans.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Interval {
    /// The lower end.
    pub lo: Span,
    /// The upper end, not below `lo`.
    pub hi: Span,
}

impl Interval {
    /// The interval that holds one value alone.
    pub const fn exactly(value: Span) -> Self {
        Self { lo: value, hi: value }
    }

    /// Upper end minus lower end.
    pub fn width(self) -> Span {
        self.hi - self.lo
    }

    /// Halfway between the ends, rounded down.
    pub const fn middle(self) -> Span {
        let (lo, hi) = (self.lo.nanos(), self.hi.nanos());
        Span::from_nanos((lo & hi) + ((lo ^ hi) >> 1))
    }

    /// Whether a span lies between the ends or on one.
    pub fn contains(self, span: Span) -> bool {
        self.lo <= span && span <= self.hi
    }

    /// What two intervals have in common; `None` when they exclude each other.
    pub fn intersection(self, other: Self) -> Option<Self> {
        let common = Self { lo: self.lo.max(other.lo), hi: self.hi.min(other.hi) };
        (common.lo <= common.hi).then_some(common)
    }

    /// The smallest interval that holds both.
    pub fn hull(self, other: Self) -> Self {
        Self { lo: self.lo.min(other.lo), hi: self.hi.max(other.hi) }
    }
}

/// What the correction of a delay rests on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DelaySource {
    /// Both ends are proven to read one clock.
    SameClock,
    /// The band estimated from exchanges between the two hosts.
    InBand,
    /// The kernels' own error bounds.
    Kernel,
    /// The error bounds of chrony.
    Chrony,
    /// The intersection of several of the above.
    Intersection,
    /// Nothing: the clocks were never related.
    None,
}

/// How far a delay can be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// The interval contains the truth and is narrower than half the delay.
    Ok,
    /// The interval contains the truth but is wider than half the delay.
    Limited,
    /// Too few fresh exchanges.
    Stale,
    /// The two clocks were never related.
    Unsynchronised,
    /// A clock was stepped near this sample.
    Stepped,
    /// Two sources exclude each other, or exchanges contradict each other: there is neither a value nor an interval.
    Inconsistent,
}

macro_rules! names {
    ($type:ident { $($variant:ident = $name:literal),* $(,)? }) => {
        impl $type {
            /// Every value, in the order of declaration.
            pub const ALL: &'static [Self] = &[$(Self::$variant),*];

            /// The name used in storage, in the API and on the pages.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),* }
            }

            /// The value of that name, if there is one.
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

/// The delay of one message from one host to another, or how much later one of two receivers had a message that others sent
/// ([`Relation::differences`](crate::Relation::differences)).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OneWayDelay {
    /// Receive stamp minus send stamp, each from its own host's wall clock; kept for ever, so that the
    /// correction can be redone. May be negative: it is not a delay yet.
    pub raw: Span,
    /// The estimate; `None` when nothing is known about the two clocks. A delay is never negative, a difference of two receivers
    /// may be.
    pub value: Option<Span>,
    /// Contains the true delay as long as the clocks' drift stays under the stated limit.
    pub bounds: Option<Interval>,
    /// What `value` and `bounds` rest on.
    pub source: DelaySource,
    /// How far they can be trusted.
    pub verdict: Verdict,
}

impl OneWayDelay {
    /// A delay between two hosts whose clocks were never related: the raw difference and nothing else.
    pub const fn unsynchronised(raw: Span) -> Self {
        Self { raw, value: None, bounds: None, source: DelaySource::None, verdict: Verdict::Unsynchronised }
    }

    /// A clock was stepped near one of the stamps, so that nothing follows from them.
    pub const fn stepped(raw: Span, source: DelaySource) -> Self {
        Self { raw, value: None, bounds: None, source, verdict: Verdict::Stepped }
    }

    /// A delay between two stamps of one clock.
    ///
    /// A wall clock that was set back in between gives a negative difference: that is a step, not a delay.
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
    fn a_negative_difference_is_never_a_delay() {
        let delay = OneWayDelay::same_clock(Span::from_nanos(-1));
        assert_eq!((delay.value, delay.bounds, delay.verdict), (None, None, Verdict::Stepped));
        assert_eq!(delay.raw, Span::from_nanos(-1));
    }

    #[test]
    fn names_lead_back_and_match_the_serialised_form() {
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
