//! The key with which the arguments of programs are fingerprinted. Descriptions of runs contain the fingerprints
//! instead of the arguments, because arguments may be secret.

use std::fs;
use std::io;
use std::path::Path;

use peernet_external::exec::FingerprintKey;
use peernet_stream::bytes_from_hexadecimal;
use uuid::Uuid;

use crate::identity::{IdentityError, cannot, read_or_create};

/// Name of the key's file in the state directory.
const FILE_NAME: &str = "argument-key";

/// Length of a key in bytes.
const KEY_BYTES: usize = 32;

/// Returns the key in `folder`; creates key and folder if they do not exist yet.
///
/// # Errors
/// When the folder cannot be used, or when the file does not contain a key.
pub fn argument_key(folder: &Path) -> Result<FingerprintKey, IdentityError> {
    read_or_create(folder, FILE_NAME, read_key, || hexadecimal(&random_key())).map(FingerprintKey::new)
}

/// Copies the key of the state directory `from` to the state directory `to`, unless `to` has a key. Equal arguments
/// then have equal fingerprints in the agents of both directories.
///
/// # Errors
/// Those of [`argument_key`].
pub fn share_argument_key(from: &Path, to: &Path) -> Result<(), IdentityError> {
    let key = read_or_create(from, FILE_NAME, read_key, || hexadecimal(&random_key()))?;
    read_or_create(to, FILE_NAME, read_key, || hexadecimal(&key)).map(drop)
}

/// Returns a key of 244 random bits: each of the two UUIDs has 122.
fn random_key() -> [u8; KEY_BYTES] {
    let mut key = [0; KEY_BYTES];
    key.copy_from_slice([Uuid::new_v4(), Uuid::new_v4()].map(Uuid::into_bytes).as_flattened());
    key
}

fn hexadecimal(key: &[u8; KEY_BYTES]) -> String {
    key.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Reads the key in a folder; `None` if the folder has no file with a key.
fn read_key(folder: &Path) -> Result<Option<[u8; KEY_BYTES]>, IdentityError> {
    let path = folder.join(FILE_NAME);
    let invalid_key = || {
        let reason =
            "it is not a key of 64 hexadecimal digits; remove the file, and the next start creates a new key";
        cannot("use", &path)(io::Error::new(io::ErrorKind::InvalidData, reason))
    };
    match fs::read_to_string(&path) {
        Ok(text) => bytes_from_hexadecimal(text.trim()).map(Some).ok_or_else(invalid_key),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        // The file is not UTF-8.
        Err(error) if error.kind() == io::ErrorKind::InvalidData => Err(invalid_key()),
        Err(error) => Err(cannot("read", &path)(error)),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn key_is_created_once_and_only_its_owner_can_read_it() {
        let folder = tempfile::tempdir().expect("a folder");
        let state = folder.path().join("state");
        argument_key(&state).expect("the key is created");
        let key = read_key(&state).expect("is readable");
        argument_key(&state).expect("the key is found");
        assert!(key.is_some() && read_key(&state).expect("is readable") == key);
        let mode = fs::metadata(state.join(FILE_NAME)).expect("is there").permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        assert_eq!(fs::read_dir(&state).expect("is there").count(), 1, "no temporary file is left");

        let other = folder.path().join("other");
        share_argument_key(&state, &other).expect("the key is copied");
        assert_eq!(read_key(&other).expect("is readable"), key);
    }

    #[test]
    fn invalid_key_file_is_refused_without_quoting_its_content() {
        let folder = tempfile::tempdir().expect("a folder");
        fs::write(folder.path().join(FILE_NAME), "hunter2").expect("writable");
        let error = argument_key(folder.path()).expect_err("the file contains no key").to_string();
        assert!(error.contains("remove the file") && !error.contains("hunter2"), "{error}");
    }
}
