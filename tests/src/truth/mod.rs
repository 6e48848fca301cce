//! True one-way delays, for comparison with reported delays.
//!
//! All namespaces of a machine share the kernel's clock. A host with clock fault injection shows other times, but
//! reports the fault. Its inverse gives the kernel's time of each stamp, and the difference of two such times is a
//! delay without an error.

mod clock;
mod comparison;
mod stored;

pub use clock::HostClock;
pub use comparison::{Comparison, compare, true_times, truth};
pub use stored::{Delay, Iteration, iterations, query_database};
