//! Bounds of the error of a probe's stamps to the unsafe side.
//!
//! Stamps are on the safe side by the place where they are made. A program's stamp of a departure is read before the
//! system call that sends, the kernel's before the driver gets the packet. The kernel's stamp of an arrival is made
//! after the driver has delivered the packet, a program's after the system call that received it. A stamp that is early
//! at a departure or late at an arrival only widens the resulting bounds. What remains is the resolution of clocks and
//! of the wire form.

use peernet_clock::Span;

/// Bound between two PEERNet ends. Clocks are read in whole nanoseconds, rounded down, which makes an arrival early by
/// 1 ns. An injected clock fault rounds by 1 ns at each end. The format of the packet adds at most 1 ns; NTP's format
/// adds nothing, because it returns our stamps exactly. Kernel and program read the same clock.
pub const OWN: Span = Span::from_nanos(4);

/// Bound with another implementation, of which it is unknown how it reads its clock. The coarsest clock that systems
/// offer for packets counts microseconds (`gettimeofday`, `SO_TIMESTAMP`) and rounds down. Its Error Estimate does not
/// help, because it is relative to UTC.
pub const FOREIGN: Span = Span::from_nanos(1_000 + OWN.nanos());

/// Tolerance of the order of events: stamps of the kernel and of the program that violate the order by more are of two
/// clocks.
pub const ORDER_TOLERANCE: Span = Span::from_micros(1);
