//! The table `[spool]`.

use std::num::{NonZeroU32, NonZeroU64};
use std::path::{Path, PathBuf};
use std::time::Duration;

use peernet_stream::Compression;
use serde::{Deserialize, Serialize};

/// `[spool]`: the file in which events wait for the aggregator. It is not used without `[agent] aggregator`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SpoolConfig {
    /// SQLite file in which events wait until the aggregator has stored them; created if missing, with its folder. Each
    /// agent needs a separate file. Default: `spool.sqlite` in `[agent] state_dir`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// Maximum number of bytes of events in the file; beyond this number the newest events are dropped, counted and
    /// reported as a gap. The file itself is a few per cent larger. 1 MiB to 1 TiB. Default: 1073741824 (1 GiB).
    pub limit_bytes: NonZeroU64,
    /// Interval at which the file is synced to the disk; milliseconds, up to a minute. Events in the spool survive a
    /// crash of the process; a power cut loses at most the events of the last interval. Default: 1000.
    pub sync_interval_ms: NonZeroU32,
    /// Compression of batches on their way to the aggregator. Default: `auto`.
    pub compression: CompressionMode,
}

/// Compression of batches on their way to the aggregator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CompressionMode {
    /// Batches are compressed while the connection to the aggregator is the bottleneck.
    #[default]
    Auto,
    /// Every batch is compressed.
    Always,
    /// No batch is compressed.
    Never,
}

impl Default for SpoolConfig {
    fn default() -> Self {
        Self {
            file: None,
            limit_bytes: const { NonZeroU64::new(1 << 30).expect("above 0") },
            sync_interval_ms: const { NonZeroU32::new(1000).expect("above 0") },
            compression: CompressionMode::Auto,
        }
    }
}

impl SpoolConfig {
    /// Returns the path of the spool of the agent with this state directory.
    pub fn path(&self, state_dir: &Path) -> PathBuf {
        self.file.clone().unwrap_or_else(|| state_dir.join("spool.sqlite"))
    }

    /// Returns the interval at which the file is synced.
    pub fn sync_interval(&self) -> Duration {
        Duration::from_millis(self.sync_interval_ms.get().into())
    }
}

impl From<CompressionMode> for Compression {
    fn from(mode: CompressionMode) -> Self {
        match mode {
            CompressionMode::Auto => Self::Auto,
            CompressionMode::Always => Self::Always,
            CompressionMode::Never => Self::Never,
        }
    }
}
