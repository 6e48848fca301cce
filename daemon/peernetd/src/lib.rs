//! What the programs `peernetd` and `peernet` share: clocks, exit codes, the terminal, the log's form, the version.

pub mod clock;
pub mod exit;
pub mod log;
pub mod output;
pub mod small_file;

/// Version with the commit it was built from.
pub const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), " (", env!("PEERNET_COMMIT"), ")");
