//! A disk that is small enough to be filled.

use std::fs::File;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use rustix::mount::{MountFlags, UnmountFlags, mount, unmount};
use rustix::process::geteuid;

/// A file system in memory. Unmounted when dropped; one that a killed test left behind goes with the next.
#[derive(Debug)]
pub struct SmallDisk {
    folder: PathBuf,
}

impl SmallDisk {
    /// Mounts a disk of so many bytes in a folder of its own.
    ///
    /// # Panics
    /// When not run as root.
    pub fn new(bytes: u64) -> Self {
        static DISKS: AtomicU32 = AtomicU32::new(0);
        assert!(
            geteuid().is_root(),
            "this test mounts a small disk, which needs root: run it as root, for instance with sudo -E"
        );
        let all = std::env::temp_dir().join("peernet-tests").join("disks");
        std::fs::create_dir_all(&all).expect("the temporary folder is writable");
        sweep(&all);
        let number = DISKS.fetch_add(1, Ordering::Relaxed);
        let folder = all.join(format!("{}-{number}", std::process::id()));
        std::fs::create_dir(&folder).expect("the temporary folder is writable");
        let options = std::ffi::CString::new(format!("size={bytes},mode=755")).expect("no zero byte");
        mount("tmpfs", &folder, "tmpfs", MountFlags::NOSUID | MountFlags::NODEV, options.as_c_str())
            .expect("root may mount a tmpfs");
        Self { folder }
    }

    /// Where it is mounted.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Takes all the room that is left.
    ///
    /// # Panics
    /// When writing fails for another reason than a full disk.
    pub fn fill(&self) {
        let mut file = File::options()
            .create(true)
            .append(true)
            .open(self.ballast())
            .expect("an empty file needs no room");
        let mut block = vec![0; 64 << 10];
        while !block.is_empty() {
            match file.write(&block) {
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::StorageFull => block.truncate(block.len() / 2),
                Err(error) => panic!("cannot fill {}: {error}", self.folder.display()),
            }
        }
    }

    /// Gives that room back.
    ///
    /// # Panics
    /// When it was not taken.
    pub fn free(&self) {
        std::fs::remove_file(self.ballast()).expect("the disk was filled");
    }

    fn ballast(&self) -> PathBuf {
        self.folder.join("ballast")
    }
}

/// Removes the disks of test processes that are gone.
fn sweep(all: &Path) {
    let folders = std::fs::read_dir(all).into_iter().flatten().flatten();
    for folder in folders.map(|entry| entry.path()) {
        let name = folder.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let owner = name.split('-').next().unwrap_or_default();
        if !Path::new("/proc").join(owner).exists() {
            remove(&folder);
        }
    }
}

fn remove(folder: &Path) {
    // Detached: a process that still has a file open does not keep it mounted.
    let _ = unmount(folder, UnmountFlags::DETACH);
    let _ = std::fs::remove_dir(folder);
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        remove(&self.folder);
    }
}
