//! Time limits of connections.

use std::time::Duration;

/// Longest time for which a connection waits while another program locks the file.
pub(crate) const BUSY_TIMEOUT: Duration = Duration::from_secs(1);
