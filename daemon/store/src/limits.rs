//! How long connections wait.

use std::time::Duration;

/// How long a connection waits for another program that locks the file.
pub(crate) const BUSY: Duration = Duration::from_secs(1);
