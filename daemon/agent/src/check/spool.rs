//! What can be wrong with `[spool]`.

use std::path::Path;

use super::{Report, usable};
use crate::config::AgentConfig;

/// Fewest bytes that a spool may hold: 1 MiB.
const MIN_LIMIT_BYTES: u64 = 1 << 20;
/// Most bytes that it may hold: 1 TiB.
const MAX_LIMIT_BYTES: u64 = 1 << 40;
/// Longest time between two syncs: a minute.
const MAX_SYNC_INTERVAL_MS: u64 = 60_000;

pub(super) fn check_spool(report: &mut Report, config: &AgentConfig) {
    let (spool, batch) = (&config.spool, config.agent.batch_bytes.get() as u64);
    let limit = spool.limit_bytes.get();
    report.at_most("spool.limit_bytes", limit, MAX_LIMIT_BYTES);
    if limit < MIN_LIMIT_BYTES {
        report.add("spool.limit_bytes", format!("{limit} is too little; at least {MIN_LIMIT_BYTES}"));
    } else if limit < 4 * batch {
        let text = format!(
            "{limit} is too little for batches of {batch} bytes; at least four of them, or lower agent.batch_bytes"
        );
        report.add("spool.limit_bytes", text);
    }
    report.at_most("spool.sync_interval_ms", spool.sync_interval_ms.get().into(), MAX_SYNC_INTERVAL_MS);
    // Without a name of its own the file is in the state_dir, which is checked.
    if let Some(file) = &spool.file {
        if file.is_dir() {
            let text = format!("{} is a folder; name a file, such as spool.sqlite, in it", file.display());
            report.add("spool.file", text);
        } else {
            let folder = file.parent().unwrap_or_else(|| Path::new("."));
            report.unless_ok("spool.file", usable(folder, "spool file"));
        }
    }
}
