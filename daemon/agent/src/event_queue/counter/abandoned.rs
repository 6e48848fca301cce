//! Removal of files of counts that no spool needs any more.

use std::fs::{self, File};

use uuid::Uuid;

use super::{CountOwner, SHARED_MEMORY, open_owned_file, read_owner, remove};

/// Removes the files of counts that no process uses, if their spool no longer exists or is `spool`.
///
/// The files named in `needed` stay, because `spool` still needs them. A file that does not contain the identity of a
/// spool stays, too.
pub(crate) fn remove_abandoned(spool: &CountOwner, needed: &[&str]) {
    let mut removed = 0_u64;
    for name in count_file_names() {
        if !needed.contains(&name.as_str())
            && open_owned_file(&name).is_some_and(|file| is_abandoned(&file, spool))
        {
            remove(&name);
            removed += 1;
        }
    }
    if removed > 0 {
        tracing::info!(
            files = removed,
            "removed files with event counts in {SHARED_MEMORY} that no spool needs any more"
        );
    }
}

/// Returns the names of all files of counts.
pub(super) fn count_file_names() -> Vec<String> {
    let entries = match fs::read_dir(SHARED_MEMORY) {
        Ok(entries) => entries,
        Err(error) => {
            tracing::debug!(%error, "cannot list {SHARED_MEMORY}: event counts of killed agents are not found");
            return Vec::new();
        }
    };
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    names.filter(|name| is_count_file_name(name)).collect()
}

/// Returns whether this is the name of a file of counts.
fn is_count_file_name(name: &str) -> bool {
    let id = name.strip_prefix("peernet-").and_then(|name| name.strip_suffix(".count"));
    id.is_some_and(|id| Uuid::try_parse(id).is_ok())
}

/// Returns whether no process counts in a file and no process can need it later. The check locks the file.
fn is_abandoned(file: &File, spool: &CountOwner) -> bool {
    file.try_lock().is_ok()
        && read_owner(file).is_some_and(|owner| owner.is_same_file(spool) || owner.is_gone())
}
