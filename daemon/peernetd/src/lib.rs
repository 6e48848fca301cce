//! What the programs `peernetd` and `peernet` share: clocks, exit codes, what is wrong with a value, the terminal and what it is told of long texts,
//! the log's form, what is a wish to end, the version.

pub mod clock;
pub mod exit;
pub mod expected;
pub mod log;
pub mod output;
pub mod short;
pub mod small_file;
pub mod wish;

/// Version with the commit it was built from.
pub const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), " (", env!("PEERNET_COMMIT"), ")");
