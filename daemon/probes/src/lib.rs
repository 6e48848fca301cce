//! Probes: small packets between two hosts that relate their wall clocks, by the Simple Two-Way Active Measurement
//! Protocol (STAMP, RFC 8762, with the extensions of RFC 8972).
//!
//! A [`Prober`] on the edge sends them, a [`Reflector`] on the cloud answers; each answer gives an
//! [`Exchange`](peernet_clock::Exchange). Both work with other implementations of STAMP and of TWAMP-light. The
//! protocol is in [`stamp`], without any I/O; sockets and timers are apart.

mod complaints;
#[doc(hidden)]
pub mod fuzzing;
mod prober;
mod reflecting;
mod schedule;
mod socket;
pub mod stamp;

pub use prober::{OpenError, ProbeResult, Prober, ProberConfig};
pub use reflecting::{BindError, Reflector, ReflectorConfig};
pub use socket::Stamps;
pub use stamp::auth::{Key, KeyError};
pub use stamp::figures::{ReflectorCounts, ReflectorFigures, Refusal};
