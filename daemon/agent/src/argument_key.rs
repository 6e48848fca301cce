//! The secret key by which this host tells commands apart without telling their arguments.

use std::fs::{self, File};
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use peernet_external::exec::FingerprintKey;
use uuid::Uuid;

use crate::identity::{IdentityError, cannot};

/// The file in the state folder.
const FILE: &str = "argument-key";

/// Bytes of a key.
const BYTES: usize = 32;

/// Returns the key in `folder`; makes it, with the folder, when it is not there yet.
///
/// # Errors
/// When the folder cannot be used or the file holds no key.
pub fn argument_key(folder: &Path) -> Result<FingerprintKey, IdentityError> {
    read_or_make(folder, || {
        let random = [Uuid::new_v4(), Uuid::new_v4()].map(Uuid::into_bytes);
        let mut key = [0; BYTES];
        key.copy_from_slice(random.as_flattened());
        key
    })
    .map(FingerprintKey::new)
}

/// Gives the agent with its state in `to` the key in `from`, unless it has one: what both tell can be compared then.
///
/// # Errors
/// As [`argument_key`].
pub fn share_argument_key(from: &Path, to: &Path) -> Result<(), IdentityError> {
    argument_key(from)?;
    let key = read(from)?;
    read_or_make(to, || key).map(drop)
}

fn read_or_make(folder: &Path, make: impl FnOnce() -> [u8; BYTES]) -> Result<[u8; BYTES], IdentityError> {
    match read(folder) {
        Err(IdentityError::Io { source, .. }) if source.kind() == io::ErrorKind::NotFound => {}
        other => return other,
    }
    fs::create_dir_all(folder).map_err(cannot("make", folder))?;
    let path = folder.join(FILE);
    let draft = folder.join(format!("{FILE}.{}", Uuid::new_v4()));
    let text: String = make().iter().map(|byte| format!("{byte:02x}")).collect();
    let written = File::options()
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(&draft)
        .and_then(|mut file| writeln!(file, "{text}").and_then(|()| file.sync_all()))
        .map_err(cannot("write", &draft));
    // Linking, unlike renaming, fails when another process was first: then its key is the one.
    let linked = written.and_then(|()| match fs::hard_link(&draft, &path) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(cannot("write", &path)(error)),
        _ => Ok(()),
    });
    let removed = fs::remove_file(&draft).map_err(cannot("remove", &draft));
    linked?;
    removed?;
    read(folder)
}

fn read(folder: &Path) -> Result<[u8; BYTES], IdentityError> {
    let path = folder.join(FILE);
    let text = fs::read_to_string(&path).map_err(cannot("read", &path))?;
    parse(text.trim()).ok_or_else(|| {
        let reason = "it holds no key of 64 hexadecimal digits; remove it, and a new one is made";
        cannot("use", &path)(io::Error::new(io::ErrorKind::InvalidData, reason))
    })
}

fn parse(text: &str) -> Option<[u8; BYTES]> {
    let mut key = [0; BYTES];
    if text.len() != 2 * BYTES || !text.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        return None;
    }
    for (at, byte) in key.iter_mut().enumerate() {
        *byte = u8::from_str_radix(&text[2 * at..2 * at + 2], 16).ok()?;
    }
    Some(key)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn the_key_stays_and_only_its_owner_reads_it() {
        let folder = tempfile::tempdir().expect("a folder");
        let state = folder.path().join("state");
        argument_key(&state).expect("made");
        let first = read(&state).expect("is there");
        argument_key(&state).expect("found");
        assert_eq!(read(&state).expect("is there"), first);
        let mode = fs::metadata(state.join(FILE)).expect("is there").permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        assert_eq!(fs::read_dir(&state).expect("is there").count(), 1, "no drafts");

        let other = folder.path().join("other");
        share_argument_key(&state, &other).expect("shared");
        assert_eq!(read(&other).expect("is there"), first);
    }

    #[test]
    fn a_file_without_a_key_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        fs::write(folder.path().join(FILE), "hunter2").expect("writable");
        let error = argument_key(folder.path()).expect_err("no key").to_string();
        assert!(error.contains("remove it") && !error.contains("hunter2"), "{error}");
    }
}
