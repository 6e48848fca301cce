//! Counts of a spool that is being replaced.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;

use super::abandoned::count_file_names;
use super::{CountOwner, OWNER_OFFSET, open_owned_file_with, read_owner};

/// The locked files of counts of a spool whose processes have ended.
// While the spool has been moved and not yet replaced, its files of counts seem abandoned. The locks keep another agent
// that starts meanwhile from removing them.
#[derive(Debug)]
pub(crate) struct LockedCounts(Vec<File>);

impl LockedCounts {
    /// Locks the files of counts of `spool`.
    pub(crate) fn of_spool(spool: &CountOwner) -> Self {
        let open = |name: &String| {
            let file = open_owned_file_with(name, File::options().read(true).write(true))?;
            let is_of_spool = read_owner(&file).is_some_and(|owner| owner.is_same_file(spool));
            (is_of_spool && file.try_lock().is_ok()).then_some(file)
        };
        Self(count_file_names().iter().filter_map(open).collect())
    }

    /// Assigns the counts to the spool that replaces the moved one, and unlocks the files.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub(crate) fn assign_to(self, spool: &CountOwner) -> io::Result<()> {
        let identity = spool.encode();
        self.0.iter().try_for_each(|file| file.write_all_at(&identity, OWNER_OFFSET as u64))
    }
}
