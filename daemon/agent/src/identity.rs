//! The host's identity: an id that stays the same over restarts, and a secret that proves that the id is this host's.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use peernet_logger::HostId;
use peernet_stream::HostSecret;

use crate::lock::FileLock;

/// Error while reading or creating a file of the host's identity.
#[derive(Debug, thiserror::Error)]
pub enum IdentityError {
    /// The folder or a file in it cannot be used.
    #[error("cannot {action} {}: {source}; check [agent] state_dir and its permissions", .path.display())]
    Io {
        /// Verb that says what was tried.
        action: &'static str,
        /// File or folder of the failed operation.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// Another agent has locked the folder.
    #[error(
        "another agent uses {}; stop it, or configure a separate [agent] state_dir for each agent", .0.display()
    )]
    InUse(PathBuf),
    /// The file does not hold a host id.
    #[error(
        "{} is not a host id: it contains {content:?}; restore it from a copy, or start as a new host with another [agent] \
         state_dir; keep this folder, because its spool may have events that are not stored", .path.display()
    )]
    NotAnId {
        /// Path of the file.
        path: PathBuf,
        /// Beginning of the content.
        content: String,
    },
    /// The file does not hold a secret. Its content is not shown, because it may be a secret of something else.
    #[error(
        "{} is not a host secret; restore it from a copy, or move it to another folder: the agent then creates a new secret, \
         which the aggregator accepts after `peernetd clear-host-secret`", .0.display()
    )]
    NotASecret(PathBuf),
}

/// Name of the host id's file in the state directory.
const ID_FILE: &str = "host-id";
/// Name of the secret's file in the state directory.
const SECRET_FILE: &str = "host-secret";
/// Permissions of both files. Whoever can read both files can impersonate this host.
const MODE: u32 = 0o600;

/// Returns the host id in the file `host-id` in `state_dir`; creates folder and file if they do not exist yet.
///
/// The file is created atomically: a power cut cannot leave half an id, and two agents that start at the same time in
/// one folder get the same id.
///
/// # Errors
/// When the folder cannot be used, or when the file does not contain a host id.
pub fn host_id(state_dir: &Path) -> Result<HostId, IdentityError> {
    read_or_create(state_dir, ID_FILE, existing_id, || HostId::random().to_string())
}

/// Returns the secret in the file `host-secret` in `state_dir`. The secret proves to the aggregator that the host id
/// belongs to this agent. Creates the file if it does not exist yet, as [`host_id`] does.
///
/// # Errors
/// When the folder cannot be used, or when the file does not contain a secret.
pub fn host_secret(state_dir: &Path) -> Result<HostSecret, IdentityError> {
    read_or_create(state_dir, SECRET_FILE, existing_secret, || HostSecret::random().expose_text())
}

/// Returns the value that `read` reads from the file `name` in `state_dir`. If there is no such file, it is created
/// with the text that `create` returns.
pub(crate) fn read_or_create<T>(
    state_dir: &Path,
    name: &'static str,
    read: impl Fn(&Path) -> Result<Option<T>, IdentityError>,
    create: impl FnOnce() -> String,
) -> Result<T, IdentityError> {
    let path = state_dir.join(name);
    if let Some(value) = read(state_dir)? {
        return Ok(value);
    }
    fs::create_dir_all(state_dir).map_err(cannot("create", state_dir))?;
    // The file is written under another name first, so that a power cut cannot leave half a file under the real name.
    let temporary_file = state_dir.join(format!("{name}.{}", HostId::random()));
    let write_result = OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(MODE)
        .open(&temporary_file)
        .and_then(|mut file| writeln!(file, "{}", create()).and_then(|()| file.sync_all()))
        .map_err(cannot("write", &temporary_file));
    // Linking, unlike renaming, fails if another process created the file first. In this case the value of that process
    // is used.
    let link_result = write_result.and_then(|()| match fs::hard_link(&temporary_file, &path) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(cannot("write", &path)(error)),
        _ => Ok(()),
    });
    let remove_result = fs::remove_file(&temporary_file).map_err(cannot("remove", &temporary_file));
    link_result?;
    remove_result?;
    // A power cut can remove a new name until its folder is synced.
    File::open(state_dir).and_then(|folder| folder.sync_all()).map_err(cannot("write", state_dir))?;
    read(state_dir)?.ok_or_else(|| {
        let error = io::Error::new(
            io::ErrorKind::NotFound,
            "another process removed the file while it was being created",
        );
        cannot("read", &path)(error)
    })
}

/// Exclusive use of a state directory by one agent. The lock ends when this value is dropped or the process ends.
#[derive(Debug)]
pub(crate) struct StateLock {
    _lock: FileLock,
}

impl StateLock {
    /// Creates the folder if it is missing, and locks the file `lock` in it.
    ///
    /// # Errors
    /// When another agent has the lock, or the file cannot be created.
    pub(crate) fn acquire(state_dir: &Path) -> Result<Self, IdentityError> {
        fs::create_dir_all(state_dir).map_err(cannot("create", state_dir))?;
        let path = state_dir.join("lock");
        match FileLock::try_acquire(&path).map_err(cannot("lock", &path))? {
            Some(lock) => Ok(Self { _lock: lock }),
            None => Err(IdentityError::InUse(state_dir.to_owned())),
        }
    }
}

/// Reads the id in `host-id` in `state_dir`; `None` if there is no such file.
pub(crate) fn existing_id(state_dir: &Path) -> Result<Option<HostId>, IdentityError> {
    let path = state_dir.join(ID_FILE);
    match fs::read_to_string(&path) {
        Ok(text) => text.trim().parse().map(Some).map_err(|_| {
            // The content is shortened, because the file may be anything.
            let content = text.trim().chars().take(40).collect();
            IdentityError::NotAnId { path, content }
        }),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(cannot("read", &path)(error)),
    }
}

/// Reads the secret in `host-secret` in `state_dir`; `None` if there is no such file.
pub(crate) fn existing_secret(state_dir: &Path) -> Result<Option<HostSecret>, IdentityError> {
    let path = state_dir.join(SECRET_FILE);
    match fs::read_to_string(&path) {
        Ok(text) => text.trim().parse().map(Some).map_err(|_| IdentityError::NotASecret(path)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        // The file is not UTF-8.
        Err(error) if error.kind() == io::ErrorKind::InvalidData => Err(IdentityError::NotASecret(path)),
        Err(error) => Err(cannot("read", &path)(error)),
    }
}

/// Returns a function that adds the attempted action and its path to an error of the operating system.
pub(crate) fn cannot(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> IdentityError + use<> {
    let path = path.to_owned();
    move |source| IdentityError::Io { action, path, source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn host_id_persists_and_folder_is_created() {
        let folder = tempfile::tempdir().expect("a folder");
        let state = folder.path().join("a").join("b");
        let id = host_id(&state).expect("the id is created");
        assert_eq!(host_id(&state).expect("the id is read"), id);
        let files: Vec<_> =
            fs::read_dir(&state).expect("there").map(|entry| entry.expect("readable")).collect();
        assert_eq!(files.len(), 1, "no temporary file is left behind");
    }

    #[test]
    fn second_agent_cannot_lock_folder() {
        let folder = tempfile::tempdir().expect("a folder");
        let lock_of_first_agent = StateLock::acquire(folder.path()).expect("the folder is free");
        let error = StateLock::acquire(folder.path()).expect_err("the folder is locked").to_string();
        assert!(error.contains("another agent uses"), "{error}");
        drop(lock_of_first_agent);
        StateLock::acquire(folder.path()).expect("the folder is free again");
    }

    #[test]
    fn concurrent_starts_get_the_same_host_id() {
        let folder = tempfile::tempdir().expect("a folder");
        let ids: Vec<_> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..8).map(|_| scope.spawn(|| host_id(folder.path()))).collect();
            threads.into_iter().map(|thread| thread.join().expect("no panic").expect("an id")).collect()
        });
        assert!(ids.iter().all(|id| *id == ids[0]));
    }

    #[test]
    fn secret_persists_and_is_readable_by_owner_only() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("a folder");
        let secret = host_secret(folder.path()).expect("the secret is created");
        assert_eq!(host_secret(folder.path()).expect("the secret is read"), secret);
        host_id(folder.path()).expect("made");
        for name in [ID_FILE, SECRET_FILE] {
            let mode = fs::metadata(folder.path().join(name)).expect("there").permissions().mode();
            assert_eq!(mode & 0o777, 0o600, "{name}");
        }
        fs::write(folder.path().join(SECRET_FILE), "my notes\n").expect("written");
        let error = host_secret(folder.path()).expect_err("not a secret").to_string();
        assert!(error.contains("host-secret") && !error.contains("my notes"), "{error}");
    }

    #[test]
    fn file_without_host_id_is_refused_with_its_content() {
        let folder = tempfile::tempdir().expect("a folder");
        fs::write(folder.path().join("host-id"), "my notes\n").expect("written");
        let error = host_id(folder.path()).expect_err("not an id").to_string();
        assert!(error.contains("host-id") && error.contains("my notes"), "{error}");
    }
}
