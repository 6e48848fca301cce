//! Permissions of files and folders that only their owner and group may use: databases, spools, host ids.
//!
//! Only the permissions of other users are removed. Those of the group stay, because the operator may have granted
//! them on purpose.

use std::ffi::OsString;
use std::fs::{self, File, Metadata, Permissions};
use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

use rustix::fs::Mode;
use rustix::process::{geteuid, umask};

/// Permission bits of users who are neither the owner nor in the group.
const OTHERS: u32 = 0o007;

/// Mode bit of folders in which every user may create files, such as `/tmp`.
const STICKY: u32 = 0o1000;

/// First bytes of every SQLite database (<https://www.sqlite.org/fileformat.html>).
const SQLITE_HEADER: &[u8] = b"SQLite format 3\0";

/// Suffixes of the files that SQLite and PEERNet create next to a database or spool. The empty suffix stands for the
/// database or spool itself.
const SUFFIXES: [&str; 6] = ["", "-wal", "-shm", "-lock", "-reserve", "-condemned"];

/// Sets the umask so that other users cannot access the files and folders that this process creates from now on. With
/// the usual umask of 022, new files have the mode 0640 and new folders 0750. Child processes inherit the umask.
///
/// Must be called before threads are started, because all threads of a process have the same umask.
pub fn restrict_new_files() {
    // The umask can only be read by replacing it. In between it is 077, which lets other users access no new file.
    let previous_umask = umask(Mode::from_raw_mode(0o077));
    umask(previous_umask | Mode::from_raw_mode(OTHERS));
}

/// Removes the permissions of other users from a database or spool of this user and from the files beside it. Returns
/// the changed files.
///
/// A file that is neither an SQLite database nor empty is left unchanged, and so are the files beside it.
// A mistyped path may lead to a file that other users need.
pub fn restrict_database(path: &Path) -> Vec<PathBuf> {
    // SQLite names the files beside a database after the resolved path.
    let path = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    if !may_be_database(&path) {
        return Vec::new();
    }
    SUFFIXES
        .iter()
        .map(|suffix| {
            let mut name = OsString::from(&path);
            name.push(suffix);
            PathBuf::from(name)
        })
        .filter(|path| restrict(path))
        .collect()
}

/// Returns whether a file is an SQLite database, is empty or does not exist. SQLite opens or creates such files.
fn may_be_database(path: &Path) -> bool {
    let mut header = Vec::new();
    let read =
        File::open(path).and_then(|file| file.take(SQLITE_HEADER.len() as u64).read_to_end(&mut header));
    match read {
        Ok(bytes) => bytes == 0 || header == SQLITE_HEADER,
        Err(error) => error.kind() == ErrorKind::NotFound,
    }
}

/// Removes the permissions of other users from a folder of this user and from the named files in the folder. Returns
/// the changed paths.
///
/// If the folder is the current folder, or a folder in which every user may create files (`/tmp`), only the files are
/// changed.
// Other users and programs need such folders.
pub fn restrict_folder(folder: &Path, files: &[&str]) -> Vec<PathBuf> {
    let is_shared = fs::metadata(folder).is_ok_and(|metadata| metadata.mode() & STICKY != 0);
    let current = std::env::current_dir().and_then(fs::canonicalize);
    let is_current =
        current.is_ok_and(|current| fs::canonicalize(folder).is_ok_and(|folder| folder == current));
    let folder_itself = (!is_shared && !is_current).then(|| folder.to_owned());
    let paths = folder_itself.into_iter().chain(files.iter().map(|file| folder.join(file)));
    paths.filter(|path| restrict(path)).collect()
}

/// Logs the changed paths in one line; logs nothing if no path was changed.
pub fn log_changes(changed: &[PathBuf]) {
    if !changed.is_empty() {
        let files = changed.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ");
        tracing::info!(
            "removed the permissions of other users from {files}; to grant a user access, use the group of the files"
        );
    }
}

/// Removes the permissions of other users from a path, and logs a failure. Returns whether the path was changed.
fn restrict(path: &Path) -> bool {
    try_restrict(path).unwrap_or_else(|error| {
        // Some files do not always exist: SQLite deletes `-wal` when a database is closed.
        if error.kind() != ErrorKind::NotFound {
            tracing::warn!(%error, "cannot remove the permissions of other users from {}", path.display());
        }
        false
    })
}

fn try_restrict(path: &Path) -> io::Result<bool> {
    let metadata = fs::symlink_metadata(path)?;
    let mode = metadata.mode() & 0o7777;
    if !is_ours(&metadata) || mode & OTHERS == 0 {
        return Ok(false);
    }
    fs::set_permissions(path, Permissions::from_mode(mode & !OTHERS))?;
    Ok(true)
}

/// Returns whether a path is a file or folder that this user owns. A symbolic link is neither.
// The target of a link may belong to anyone.
fn is_ours(metadata: &Metadata) -> bool {
    (metadata.is_file() || metadata.is_dir()) && metadata.uid() == geteuid().as_raw()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write_database(path: &Path, mode: u32) {
        fs::write(path, SQLITE_HEADER).expect("writable");
        fs::set_permissions(path, Permissions::from_mode(mode)).expect("own file");
    }

    fn mode(path: &Path) -> u32 {
        fs::metadata(path).expect("is there").mode() & 0o7777
    }

    #[test]
    fn permissions_of_owner_and_group_are_kept() {
        let folder = tempfile::tempdir().expect("a folder");
        let database = folder.path().join("a.sqlite");
        for (suffix, before, after) in
            [("", 0o644, 0o640), ("-wal", 0o666, 0o660), ("-shm", 0o600, 0o600), ("-lock", 0o646, 0o640)]
        {
            let path = folder.path().join(format!("a.sqlite{suffix}"));
            write_database(&path, before);
            restrict_database(&database);
            assert_eq!(mode(&path), after, "{suffix}");
        }
        assert_eq!(restrict_database(&database), Vec::<PathBuf>::new());
    }

    #[test]
    fn only_databases_and_empty_files_are_restricted() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("passwd");
        for (contents, after) in [("root:x:0:0:root:/root:/bin/bash\n", 0o644), ("", 0o640)] {
            fs::write(&path, contents).expect("writable");
            fs::set_permissions(&path, Permissions::from_mode(0o644)).expect("own file");
            restrict_database(&path);
            assert_eq!(mode(&path), after, "{contents}");
        }
    }

    #[test]
    fn folder_is_restricted_unless_all_users_may_write() {
        let folder = tempfile::tempdir().expect("a folder");
        for (before, after) in [(0o755, 0o750), (0o775, 0o770), (0o700, 0o700), (0o1777, 0o1777)] {
            fs::set_permissions(folder.path(), Permissions::from_mode(before)).expect("own folder");
            write_database(&folder.path().join("host-id"), 0o644);
            restrict_folder(folder.path(), &["host-id", "missing"]);
            assert_eq!(mode(folder.path()), after);
            assert_eq!(mode(&folder.path().join("host-id")), 0o640);
        }
    }

    #[test]
    fn target_of_link_keeps_its_permissions() {
        let folder = tempfile::tempdir().expect("a folder");
        let target = folder.path().join("target");
        write_database(&target, 0o644);
        std::os::unix::fs::symlink(&target, folder.path().join("host-id")).expect("a link");
        restrict_folder(folder.path(), &["host-id"]);
        assert_eq!(mode(&target), 0o644);
    }
}
