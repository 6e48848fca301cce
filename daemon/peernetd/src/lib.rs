//! What the programs `peernetd` and `peernet` share: clocks, exit codes, the terminal, the version.

pub mod clock;
pub mod exit;
pub mod output;

/// Version with the commit it was built from.
pub const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), " (", env!("PEERNET_COMMIT"), ")");
