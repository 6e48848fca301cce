//! Largest errors of a probe's stamps in the unsafe direction, in which an error makes the bounds of the clock offset
//! wrong.
//!
//! The order of the readings puts most errors on the safe side. At a departure, the program makes its stamp before the
//! system call that sends, and the kernel makes its stamp before the driver gets the packet. At an arrival, the kernel
//! makes its stamp after the driver has delivered the packet, and the program after the system call that received it. A
//! stamp that is early at a departure or late at an arrival only widens the resulting bounds. Only the limited
//! resolution of the clocks and of the wire form can cause errors in the unsafe direction.

use peernet_clock::Span;

/// Largest error in the unsafe direction of a probe between two PEERNet ends.
// Clocks are read in whole nanoseconds, rounded down, which makes an arrival early by 1 ns. An injected clock fault
// rounds by 1 ns at each end. The format of the packet adds at most 1 ns; NTP's format adds nothing, because it returns
// our stamps exactly. Kernel and program read the same clock.
pub const PEERNET_ENDS: Span = Span::from_nanos(4);

/// Largest error in the unsafe direction of a probe whose reflector is another implementation.
// The coarsest clock that systems offer for packets counts microseconds (`gettimeofday`, `SO_TIMESTAMP`) and rounds
// down. The Error Estimate of the reply does not help, because it is relative to UTC.
pub const OTHER_IMPLEMENTATION: Span = Span::from_nanos(1_000 + PEERNET_ENDS.nanos());

/// Largest span by which stamps of one clock may violate the order of events. If stamps of the kernel and of the
/// program violate the order by more, they are of two different clocks.
pub const ORDER_TOLERANCE: Span = Span::from_micros(1);
