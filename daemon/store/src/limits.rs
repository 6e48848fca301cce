//! Time limits of connections.

use std::time::Duration;

/// Time that a connection waits for another program that locks the file.
pub(crate) const BUSY: Duration = Duration::from_secs(1);
