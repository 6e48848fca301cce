//! What one-way delays really were, against what was reported.
//!
//! All namespaces of a machine read the kernel's clock. A rehearsed host shows something else, but says what: turning
//! that round gives the kernel's time of each stamp, and the difference of two of them is a delay without an error.

mod clock;
mod comparison;
mod stored;

pub use clock::HostClock;
pub use comparison::{Comparison, compare, true_times, truth};
pub use stored::{Delay, Iteration, ask, iterations};
