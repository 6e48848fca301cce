//! Probes: small packets between two hosts that relate their clocks, by the Simple Two-Way Active Measurement Protocol
//! (STAMP, RFC 8762, with the extensions of RFC 8972).
//!
//! A [`Prober`] on the edge sends probes and a [`Reflector`] on the cloud answers them. Each answer gives an
//! [`Exchange`](peernet_clock::Exchange). Both work with other implementations of STAMP and of TWAMP-light.
//!
//! - [`stamp`]: the protocol without any I/O. `packet`, `tlv`, `timestamp` and `auth` are the wire forms, `sender` and
//!   `reflector` the state machines of the two roles.
//! - `socket`: UDP with the kernel's stamps, if it makes them and they are of the clock that the program reads.
//! - `prober` and `reflector` drive the two roles; `schedule` has the times of probes, `refusal_log` the log lines
//!   about refused ones.
//!
//! Probes must be answered by the process that serves the data. A process draws a random number that its reflector's
//! answers and its sessions both carry; answers with another number are refused. A key that is drawn in the same way
//! authenticates probes where no key is configured.

#[doc(hidden)]
pub mod fuzzing;
mod prober;
mod reflector;
mod refusal_log;
mod schedule;
mod socket;
pub mod stamp;

pub use prober::{OpenError, ProbeResult, Prober, ProberConfig};
pub use reflector::{BindError, ReceiveError, Reflector, ReflectorConfig};
pub use socket::Stamps;
pub use stamp::auth::{Key, KeyError};
pub use stamp::figures::{ReflectorCounts, ReflectorFigures, Refusal};
