//! Time limits of connections.

use std::time::Duration;

/// Longest wait of a connection for another program that locks the file.
pub(crate) const BUSY_TIMEOUT: Duration = Duration::from_secs(1);
