//! Kinds of nodes and their values.

use peernet_clock::{OneWayDelay, RawTime, Span, WallTime};
use serde::{Deserialize, Serialize};

use crate::{Name, TreeError, Unit};

/// Kind and value of a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Measure {
    /// A node that only contains other nodes.
    Container,
    /// Duration on one host; `None` while the timer is open.
    Timer(Option<Span>),
    /// Transfer of a message from one host to another.
    Transit(Box<Transit>),
    /// A number with a unit.
    Value(f64, Unit),
    /// Rate in bits per second.
    Throughput(Rate),
    /// Tokens per second of a language model; `None` while the node is open.
    TokenRate(Option<f64>),
    /// A custom kind: name, unit and value. The value is `None` while the node is open, or if the reading failed.
    Custom(Name, Unit, Option<f64>),
}

/// A rate of a transfer, bits per second, with the interval that follows from the interval of the transfer's delay.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rate {
    /// Estimate; `None` if the delay has no estimate.
    pub value: Option<f64>,
    /// Lower and upper bound; `None` if the delay has no interval. The upper bound is infinite if the delay's interval
    /// includes zero.
    pub bounds: Option<(f64, f64)>,
}

/// Transfer of a message between two hosts. The sender opens it, the receiver closes it, and the edge adds the delay.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Transit {
    /// Time on the sender's wall clock just before the message was handed to the network.
    pub sent: WallTime,
    /// Time on the receiver's wall clock when the whole message had arrived; `None` while it is in flight.
    pub received: Option<WallTime>,
    /// Delay; `None` until the edge has related the two clocks.
    pub delay: Option<OneWayDelay>,
    /// Stamps of the same two events on the free-running clocks of the hosts. The delay is computed from them. `None`
    /// while the message is in flight, and in trees that releases before 0.3 recorded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub raw_stamps: Option<RawStamps>,
}

/// Time at which a message left one host, and time at which it arrived at another, each on the free-running clock of
/// its host. A cloud that has no stamps of this clock sends stamps of its wall clock ([`RawTime::from_wall`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RawStamps {
    /// Time on the sender's clock just before the message was handed to the network.
    pub sent: RawTime,
    /// Time on the receiver's clock when the whole message had arrived.
    pub received: RawTime,
}

impl Measure {
    /// Returns whether the node is still open. A custom node or a token rate without a value counts as open, too.
    pub fn is_open(&self) -> bool {
        match self {
            Self::Timer(None) | Self::TokenRate(None) | Self::Custom(_, _, None) => true,
            Self::Transit(transit) => transit.received.is_none(),
            _ => false,
        }
    }

    /// Returns the number that is stored and used in statistics, in the unit [`unit`](Self::unit). `None` if there is
    /// no number, such as for a container, an open node or an unknown delay.
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

    /// Returns the unit of [`value`](Self::value).
    pub fn unit(&self) -> Unit {
        match self {
            Self::Container => Unit::NONE,
            Self::Timer(_) | Self::Transit(_) => Unit::SECONDS,
            Self::Throughput(_) => Unit::BITS_PER_SECOND,
            Self::TokenRate(_) => Unit::TOKENS_PER_SECOND,
            Self::Value(_, unit) | Self::Custom(_, unit, _) => unit.clone(),
        }
    }

    /// Replaces NaN, the result of a failed reading, by an absent value.
    #[must_use]
    pub(crate) fn without_nan(self) -> Self {
        match self {
            Self::Value(value, unit) if value.is_nan() => {
                // A `Value` always has a number. A node of a custom kind may have no number.
                Self::Custom(Name::from_static("value"), unit, None)
            }
            Self::Custom(kind, unit, Some(value)) if value.is_nan() => Self::Custom(kind, unit, None),
            Self::TokenRate(Some(rate)) if rate.is_nan() => Self::TokenRate(None),
            Self::Throughput(rate) => Self::Throughput(Rate {
                value: rate.value.filter(|value| !value.is_nan()),
                // If a bound is NaN, the comparison is false, so that the bounds are removed.
                bounds: rate.bounds.filter(|(lo, hi)| lo <= hi),
            }),
            other => other,
        }
    }

    /// Checks whether the value is allowed in a tree. `position` is the position of the node, for the error.
    pub(crate) fn check(&self, position: usize) -> Result<(), TreeError> {
        let (number, are_bounds_ordered) = match self {
            Self::Container | Self::Timer(_) => (None, true),
            Self::Transit(transit) => (
                None,
                transit.delay.and_then(|delay| delay.bounds).is_none_or(|bounds| bounds.lo <= bounds.hi),
            ),
            Self::Value(value, _) => (Some(*value), true),
            Self::Throughput(rate) => (rate.value, rate.bounds.is_none_or(|(lo, hi)| lo <= hi)),
            Self::TokenRate(value) | Self::Custom(_, _, value) => (*value, true),
        };
        // Infinite values are allowed: they stay in the tree, and statistics ignore them.
        if number.is_some_and(f64::is_nan) {
            return Err(TreeError::NotANumber(position));
        }
        if are_bounds_ordered { Ok(()) } else { Err(TreeError::CrossedBounds(position)) }
    }

    /// Returns the name of the kind: `container`, `timer`, `transit`, `value`, `throughput`, `token-rate`, or the name
    /// of the custom kind.
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
