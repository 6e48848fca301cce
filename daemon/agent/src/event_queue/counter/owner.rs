//! Identity of the spool that a file of counts belongs to.

use std::ffi::OsStr;
use std::fs::{self, Metadata};
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// Largest length of an encoded identity in bytes, and the length of its field in the file of counts.
pub(super) const OWNER_BYTES: usize = 4096;
/// Bytes before the path: four numbers and the length of the path.
const NUMBERS_BYTES: usize = 4 * 8 + 2;
/// Path of the file that identifies the mount namespace. A path means the same file only within one mount namespace.
const MOUNT_NAMESPACE: &str = "/proc/self/ns/mnt";

/// Identity of a spool file. A copy of the spool has another identity.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct CountOwner {
    device: u64,
    inode: u64,
    /// Creation time of the file in nanoseconds since 1970; 0 if its file system does not store it.
    // Needed because the inode number of a deleted file is used again.
    created: u64,
    /// Inode of the mount namespace; 0 if it is unknown.
    mount_namespace: u64,
    /// Path of the file; empty if it is too long to be stored.
    path: PathBuf,
}

impl CountOwner {
    /// Returns the identity of the file at a path.
    ///
    /// # Errors
    /// When there is no such file.
    pub(crate) fn from_path(path: &Path) -> io::Result<Self> {
        let (path, metadata) = (fs::canonicalize(path)?, fs::metadata(path)?);
        let path = if path.as_os_str().len() > OWNER_BYTES - NUMBERS_BYTES { PathBuf::new() } else { path };
        let mount_namespace = mount_namespace().unwrap_or_default();
        Ok(Self {
            device: metadata.dev(),
            inode: metadata.ino(),
            created: creation_time_ns(&metadata),
            mount_namespace,
            path,
        })
    }

    /// Returns whether both identities belong to the same file, even if its paths differ.
    pub(crate) fn is_same_file(&self, other: &Self) -> bool {
        (self.device, self.inode, self.created) == (other.device, other.inode, other.created)
    }

    /// Returns whether the file is certainly no longer at its path. This is not certain from within another mount
    /// namespace. It is also not certain while another file system is mounted there, because the file system of the
    /// file may be mounted again.
    pub(super) fn is_gone(&self) -> bool {
        if !self.path.is_absolute()
            || mount_namespace().is_none_or(|namespace| namespace != self.mount_namespace)
        {
            return false;
        }
        match fs::metadata(&self.path) {
            Ok(metadata) => {
                metadata.dev() == self.device
                    && (metadata.ino(), creation_time_ns(&metadata)) != (self.inode, self.created)
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => self.nearest_folder_is_on_same_device(),
            // Nothing is certain, for example without permission to read the folder.
            Err(_) => false,
        }
    }

    /// Returns whether the nearest existing folder of the path is on the device on which the file was.
    fn nearest_folder_is_on_same_device(&self) -> bool {
        let mut folders = self.path.ancestors().skip(1);
        folders
            .find_map(|folder| fs::metadata(folder).ok())
            .is_some_and(|metadata| metadata.dev() == self.device)
    }

    /// Encodes the identity in at most [`OWNER_BYTES`] bytes: four numbers, the length of the path, and the path.
    pub(super) fn encode(&self) -> Vec<u8> {
        let numbers =
            [self.device, self.inode, self.created, self.mount_namespace].map(u64::to_be_bytes).concat();
        let path = self.path.as_os_str().as_bytes();
        let length = u16::try_from(path.len()).unwrap_or_default().to_be_bytes();
        [&numbers[..], &length, path].concat()
    }

    /// Decodes an identity; `None` if the bytes are too short.
    pub(super) fn decode(bytes: &[u8]) -> Option<Self> {
        let (numbers, rest) = bytes.split_at_checked(NUMBERS_BYTES - 2)?;
        let number =
            |index: usize| numbers[index * 8..].first_chunk().map(|bytes| u64::from_be_bytes(*bytes));
        let (length, path) = rest.split_first_chunk()?;
        let path = path.get(..u16::from_be_bytes(*length).into())?;
        Some(Self {
            device: number(0)?,
            inode: number(1)?,
            created: number(2)?,
            mount_namespace: number(3)?,
            path: Path::new(OsStr::from_bytes(path)).to_owned(),
        })
    }
}

fn creation_time_ns(metadata: &Metadata) -> u64 {
    let since_epoch = metadata.created().ok().and_then(|created| created.duration_since(UNIX_EPOCH).ok());
    since_epoch.and_then(|duration| u64::try_from(duration.as_nanos()).ok()).unwrap_or_default()
}

fn mount_namespace() -> Option<u64> {
    fs::metadata(MOUNT_NAMESPACE).ok().map(|namespace| namespace.ino())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoded_owner_decodes_to_equal_owner() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("spool.sqlite");
        fs::write(&path, "spool").expect("written");
        let owner = CountOwner::from_path(&path).expect("is there");
        assert_eq!(CountOwner::decode(&owner.encode()).as_ref(), Some(&owner));
        assert_eq!(CountOwner::decode(&[0; 12]), None);
    }

    #[test]
    fn file_is_gone_only_if_certainly_deleted() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("spool.sqlite");
        fs::write(&path, "spool").expect("written");
        let owner = CountOwner::from_path(&path).expect("is there");
        assert!(!owner.is_gone());
        let elsewhere = CountOwner { mount_namespace: owner.mount_namespace + 1, ..owner.clone() };
        let unmounted = CountOwner { device: owner.device + 1, ..owner.clone() };
        drop(folder);
        assert!(owner.is_gone());
        assert!(!elsewhere.is_gone(), "the path means something else in another mount namespace");
        assert!(!unmounted.is_gone(), "the file system of the file is not mounted");
    }
}
