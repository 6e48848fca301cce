//! Kind and content of a node.

use peernet_clock::{OneWayDelay, RawTime, Span, WallTime};
use serde::{Deserialize, Serialize};

use crate::{Name, TreeError, Unit};

/// Kind and content of a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Measure {
    /// Holds other nodes.
    Container,
    /// A duration on one host; `None` while it is open.
    Timer(Option<Span>),
    /// A message's way from one host to another.
    Transit(Box<Transit>),
    /// A number with a unit.
    Value(f64, Unit),
    /// Bits per second.
    Throughput(Rate),
    /// Tokens per second of a language model; `None` while it is open.
    TokenRate(Option<f64>),
    /// A kind that the user declared by name and unit; `None` while it is open.
    Custom(Name, Unit, Option<f64>),
}

/// A rate with the interval that follows from its delay's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rate {
    /// The estimate; `None` when the delay has none.
    pub value: Option<f64>,
    /// Lower and upper bound; the upper one is infinite when the delay's interval reaches zero.
    pub bounds: Option<(f64, f64)>,
}

/// A message between two hosts: opened by the sender, closed by the receiver, judged by the edge.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Transit {
    /// The sender's wall clock just before the message was handed to the network.
    pub sent: WallTime,
    /// The receiver's wall clock when the whole message was there; `None` while it is under way.
    pub received: Option<WallTime>,
    /// The delay, once the edge has related the two clocks.
    pub delay: Option<OneWayDelay>,
    /// The same moments on the related clocks, by which the delay is judged; `None` while the message is under way, and in what releases
    /// before 0.3 recorded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub raw_stamps: Option<RawStamps>,
}

/// When a message left one host and arrived at another, by the free-running clock of each. A cloud that has no stamps of it gives those of
/// its wall clock, [`RawTime::of_wall`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RawStamps {
    /// The sender's clock just before the message was handed to the network.
    pub sent: RawTime,
    /// The receiver's clock when the whole message was there.
    pub received: RawTime,
}

impl Measure {
    /// Whether the node still waits for its end.
    pub fn is_open(&self) -> bool {
        match self {
            Self::Timer(None) | Self::TokenRate(None) | Self::Custom(_, _, None) => true,
            Self::Transit(transit) => transit.received.is_none(),
            _ => false,
        }
    }

    /// The number to store and to compute statistics over, in the unit of [`unit`](Self::unit).
    pub fn value(&self) -> Option<f64> {
        match self {
            Self::Container => None,
            Self::Timer(span) => span.map(Span::seconds),
            Self::Transit(transit) => transit.delay.and_then(|delay| delay.value).map(Span::seconds),
            Self::Value(value, _) => Some(*value),
            Self::Throughput(rate) => rate.value,
            Self::TokenRate(rate) => *rate,
            Self::Custom(_, _, value) => *value,
        }
    }

    /// The unit of [`value`](Self::value).
    pub fn unit(&self) -> Unit {
        match self {
            Self::Container => Unit::NONE,
            Self::Timer(_) | Self::Transit(_) => Unit::SECONDS,
            Self::Throughput(_) => Unit::BITS_PER_SECOND,
            Self::TokenRate(_) => Unit::TOKENS_PER_SECOND,
            Self::Value(_, unit) | Self::Custom(_, unit, _) => unit.clone(),
        }
    }

    /// The same measurement, a number that is not one replaced by none: the reading was tried and failed.
    #[must_use]
    pub(crate) fn without_nan(self) -> Self {
        match self {
            Self::Value(value, unit) if value.is_nan() => {
                Self::Custom(Name::from_static("value"), unit, None)
            }
            Self::Custom(kind, unit, Some(value)) if value.is_nan() => Self::Custom(kind, unit, None),
            Self::TokenRate(Some(rate)) if rate.is_nan() => Self::TokenRate(None),
            Self::Throughput(rate) => Self::Throughput(Rate {
                value: rate.value.filter(|value| !value.is_nan()),
                bounds: rate.bounds.filter(|(lo, hi)| lo <= hi),
            }),
            other => other,
        }
    }

    /// Whether it can stand in a tree, at position `at`.
    pub(crate) fn check(&self, at: usize) -> Result<(), TreeError> {
        let (number, ordered) = match self {
            Self::Container | Self::Timer(_) => (None, true),
            Self::Transit(transit) => (
                None,
                transit.delay.and_then(|delay| delay.bounds).is_none_or(|bounds| bounds.lo <= bounds.hi),
            ),
            Self::Value(value, _) => (Some(*value), true),
            Self::Throughput(rate) => (rate.value, rate.bounds.is_none_or(|(lo, hi)| lo <= hi)),
            Self::TokenRate(value) | Self::Custom(_, _, value) => (*value, true),
        };
        if number.is_some_and(f64::is_nan) {
            return Err(TreeError::NotANumber(at));
        }
        if ordered { Ok(()) } else { Err(TreeError::CrossedBounds(at)) }
    }

    /// The name of the kind: `container`, `timer`, `transit`, `value`, `throughput`, `token-rate`, or the
    /// user's own.
    pub fn kind(&self) -> Name {
        match self {
            Self::Container => Name::from_static("container"),
            Self::Timer(_) => Name::from_static("timer"),
            Self::Transit(_) => Name::from_static("transit"),
            Self::Value(..) => Name::from_static("value"),
            Self::Throughput(_) => Name::from_static("throughput"),
            Self::TokenRate(_) => Name::from_static("token-rate"),
            Self::Custom(kind, ..) => kind.clone(),
        }
    }
}
