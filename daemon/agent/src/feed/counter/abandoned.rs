//! Files of counts that no spool needs any more.

use std::fs::{self, File};
use std::path::Path;

use uuid::Uuid;

use super::{CountOwner, SHARED_MEMORY, open_own, owner, remove};

/// Removes the files of counts in which no process counts, and whose spool is gone or is `own`, which needs those named in `needed` only.
/// A file that does not say which spool it belongs to stays.
pub(crate) fn remove_abandoned(own: &CountOwner, needed: &[&str]) {
    let entries = match fs::read_dir(SHARED_MEMORY) {
        Ok(entries) => entries,
        Err(error) => {
            tracing::debug!(%error, "cannot list {SHARED_MEMORY}: the counts of agents that were killed stay there");
            return;
        }
    };
    let mut removed = 0_u64;
    for name in entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok()) {
        if is_name(&name)
            && !needed.contains(&name.as_str())
            && open_own(&name).is_some_and(|file| is_abandoned(&file, own))
        {
            remove(&name);
            removed += 1;
        }
    }
    if removed > 0 {
        tracing::info!(files = removed, "removed counts of events in {SHARED_MEMORY} whose spools are gone");
    }
}

/// Says whether a file has a name of ours.
fn is_name(name: &str) -> bool {
    let id = name.strip_prefix("peernet-").and_then(|name| name.strip_suffix(".count"));
    id.is_some_and(|id| Uuid::try_parse(id).is_ok()) && Path::new(name).file_name().is_some()
}

/// Says whether nobody counts in a file, and no later process can need it. It is locked as long as it is looked at.
fn is_abandoned(file: &File, own: &CountOwner) -> bool {
    file.try_lock().is_ok() && owner(file).is_some_and(|owner| owner.is_same_file(own) || owner.is_gone())
}
