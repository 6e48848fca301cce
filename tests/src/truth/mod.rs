//! True one-way delays, for comparison with reported delays.
//!
//! All namespaces of a machine share the kernel's clock. A host with clock fault injection shows other times, but
//! reports the fault. The inverse of the fault gives the kernel's time of each stamp, and the difference of two such times is a
//! delay without an error.

mod clock;
mod comparison;
mod stored;

pub use clock::HostClock;
pub use comparison::{Comparison, compare, true_delay, true_times};
pub use stored::{Delay, Iteration, iterations, query_database};
