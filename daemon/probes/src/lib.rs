//! Probes: small packets between two hosts that relate their wall clocks, by the Simple Two-Way Active Measurement
//! Protocol (STAMP, RFC 8762, with the extensions of RFC 8972).
//!
//! A [`Prober`] on the edge sends them, a [`Reflector`] on the cloud answers; each answer gives an
//! [`Exchange`](peernet_clock::Exchange). Both work with other implementations of STAMP and of TWAMP-light.
//!
//! - [`stamp`]: the protocol, without any I/O: `packet`, `tlv`, `timestamp` and `auth` are its forms, `sender` and
//!   `reflector` what the two roles decide.
//! - `socket`: UDP with the kernel's stamps, where there are any and they are of the clock that the program reads.
//! - `prober` and `reflecting` drive the two roles; `schedule` says when probes are due, `complaints` what is told of
//!   refused ones.

mod complaints;
#[doc(hidden)]
pub mod fuzzing;
mod prober;
mod reflecting;
mod schedule;
mod socket;
pub mod stamp;

pub use prober::{OpenError, ProbeResult, Prober, ProberConfig};
pub use reflecting::{BindError, ReceiveError, Reflector, ReflectorConfig};
pub use socket::Stamps;
pub use stamp::auth::{Key, KeyError};
pub use stamp::figures::{ReflectorCounts, ReflectorFigures, Refusal};
