//! How wrong to the unsafe side the stamps of a probe can be: the one place where it is stated.
//!
//! Stamps are on the safe side by where they are made. A program's stamp of a departure is read before the system call
//! that sends, the kernel's before the driver is given the packet; the kernel's stamp of an arrival is made after the
//! packet came out of the driver, a program's after the system call that received it. Being early at a departure and
//! late at an arrival only widens what follows. Left over is how finely clocks are read and stamps travel:

use peernet_clock::Span;

/// Between two ends of ours. Clocks are read in whole nanoseconds, rounded down, which makes an arrival early by 1 ns;
/// a false clock for a rehearsal rounds by 1 ns at each end; the packet's format adds at most 1 ns (nothing in NTP's
/// format, which gives our stamps back exactly). Kernel and program read one and the same clock.
pub const OWN: Span = Span::from_nanos(4);

/// With another implementation, of which we do not know how it reads its clock: the coarsest way that systems offer for
/// packets counts microseconds (`gettimeofday`, `SO_TIMESTAMP`) and rounds down. Its Error Estimate does not help: it
/// speaks of UTC where it claims to follow it.
pub const FOREIGN: Span = Span::from_nanos(1_000 + OWN.nanos());

/// Stamps of one clock by the kernel and by the program are in the order of the events to this, or they are of two
/// clocks.
pub const AGREEMENT: Span = Span::from_micros(1);
