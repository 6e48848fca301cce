//! `[spool]`

use std::num::{NonZeroU32, NonZeroU64};
use std::path::{Path, PathBuf};
use std::time::Duration;

use peernet_stream::Compression;
use serde::{Deserialize, Serialize};

/// `[spool]`: where events wait for the aggregator. Without `[agent] aggregator` there is none.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SpoolConfig {
    /// SQLite file that holds the events until the aggregator has stored them; made when missing, with its folder.
    /// Each agent needs its own. Default: `spool.sqlite` in `[agent] state_dir`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// Bytes of events that the file may hold; beyond it the newest events are dropped, counted and reported as a gap.
    /// The file itself takes a few per cent more. 1 MiB to 1 TiB. Default: 1073741824 (1 GiB).
    pub limit_bytes: NonZeroU64,
    /// How often what was written to the file is synced to the disk; milliseconds, up to a minute. What is in the
    /// spool survives a crash of the process; a power cut loses at most what came within this interval. Default: 1000.
    pub sync_interval_ms: NonZeroU32,
    /// Whether batches are compressed on their way to the aggregator. Default: `auto`.
    pub compression: CompressionMode,
}

/// Whether batches are compressed on their way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CompressionMode {
    /// While the link is what batches wait for.
    #[default]
    Auto,
    /// Every batch.
    Always,
    /// None.
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
    /// The file of the agent with this folder.
    pub fn path(&self, state_dir: &Path) -> PathBuf {
        self.file.clone().unwrap_or_else(|| state_dir.join("spool.sqlite"))
    }

    /// How often the file is synced.
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
