//! Probes: small packets between two hosts that relate their clocks, by the Simple Two-Way Active Measurement Protocol
//! (STAMP, RFC 8762, with the extensions of RFC 8972).
//!
//! A [`Prober`] on the edge sends probes and a [`Reflector`] on the cloud answers them. Each answer gives an
//! [`Exchange`](peernet_clock::Exchange). Both work with other implementations of STAMP and of TWAMP-light.
//!
//! - [`stamp`]: the protocol STAMP without any I/O. `packet`, `tlv`, `timestamp` and `auth` are the wire forms,
//!   `sender` and `reflector` the state machines of the two roles.
//! - `socket`: UDP with the kernel's timestamps, if the kernel supports them and reads the same clock as the program.
//! - `prober` and `reflector`: sockets and timers of the two roles. `schedule` has the times of probes, and
//!   `refusal_log` limits the log lines about refused probes.
//!
//! Probes must be answered by the process that serves the data, because that process stamps the data. Each process
//! therefore chooses a random number at its start. The number is sent with every accepted session and with every answer
//! to a probe, and a prober refuses answers with another number. If no key is configured, a random key of the process
//! authenticates probes; peers get this key with their session.

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
pub use socket::TimestampSource;
pub use stamp::auth::{Key, KeyError};
pub use stamp::counters::{ReflectorCounters, ReflectorCounts, Refusal};
