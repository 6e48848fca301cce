//! Disks for tests: a small one that can be filled, and one that can be unmounted and made read-only.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::Errno;
use rustix::mount::{MountFlags, UnmountFlags, mount, unmount};
use rustix::process::geteuid;

/// File system in memory. It is unmounted when dropped; the next test removes the disk of a killed test.
#[derive(Debug)]
pub struct SmallDisk {
    folder: PathBuf,
}

impl SmallDisk {
    /// Mounts a disk of this size, bytes.
    ///
    /// # Panics
    /// If the test does not run as root.
    pub fn new(bytes: u64) -> Self {
        let folder = mount_point();
        let options = std::ffi::CString::new(format!("size={bytes},mode=755")).expect("no zero byte");
        mount("tmpfs", &folder, "tmpfs", MountFlags::NOSUID | MountFlags::NODEV, options.as_c_str())
            .expect("root may mount a tmpfs");
        Self { folder }
    }

    /// Returns the mount point.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Fills the disk.
    pub fn fill(&self) {
        fill(&self.folder);
    }

    /// Frees the space that [`fill`](Self::fill) took.
    pub fn free(&self) {
        free(&self.folder);
    }
}

/// ext4 file system in a file, on a loop device. It is unmounted when dropped; the next test removes the disk of a killed
/// test.
#[derive(Debug)]
pub struct ImageDisk {
    folder: PathBuf,
    image: PathBuf,
}

/// Second mount point of a disk.
#[derive(Debug)]
pub struct SecondMount {
    folder: PathBuf,
}

impl ImageDisk {
    /// Creates and mounts a disk of this size, bytes.
    ///
    /// # Panics
    /// If the test does not run as root, or if the kernel has no loop devices.
    pub fn new(bytes: u64) -> Self {
        let folder = mount_point();
        let image = folder.with_extension("img");
        let file = File::create(&image).expect("the temporary folder is writable");
        file.set_len(bytes).expect("the temporary folder is writable");
        let disk = Self { folder, image };
        run("mkfs.ext4", &["-q", &text(&disk.image)]);
        disk.mount();
        disk
    }

    /// Returns the mount point.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Mounts the disk.
    pub fn mount(&self) {
        run("mount", &["-o", "loop", &text(&self.image), &text(&self.folder)]);
    }

    /// Detaches the disk from its folder at once. Open files keep it in use.
    ///
    /// # Panics
    /// If the disk is not mounted.
    pub fn unmount(&self) {
        unmount(&self.folder, UnmountFlags::DETACH).expect("the disk is mounted");
    }

    /// Fills the disk.
    pub fn fill(&self) {
        fill(&self.folder);
    }

    /// Frees the space that [`fill`](Self::fill) took.
    pub fn free(&self) {
        free(&self.folder);
    }

    /// Returns whether a loop device still uses the image. After an unmount this lasts until the last open file is closed.
    pub fn is_in_use(&self) -> bool {
        !run("losetup", &["--associated", &text(&self.image)]).trim().is_empty()
    }

    /// Remounts the disk with an option, such as `ro`.
    ///
    /// # Panics
    /// If the system refuses because a file is open for writing.
    pub fn remount(&self, option: &str) {
        run("mount", &["-o", &format!("remount,{option}"), &text(&self.folder)]);
    }

    /// Sets or clears the immutable attribute of existing files in `files`. An immutable file cannot be written even by root
    /// or through open descriptors.
    pub fn set_immutable(&self, files: &[PathBuf], immutable: bool) {
        for file in files.iter().filter(|file| file.exists()) {
            run("chattr", &[if immutable { "+i" } else { "-i" }, &text(file)]);
        }
    }

    /// Mounts the disk at a second mount point.
    pub fn mount_again(&self) -> SecondMount {
        let second = SecondMount { folder: mount_point() };
        run("mount", &["--bind", &text(&self.folder), &text(&second.folder)]);
        second
    }
}

impl SecondMount {
    /// Returns the second mount point.
    pub fn folder(&self) -> &Path {
        &self.folder
    }
}

/// Allocates all free space of a folder's disk.
fn fill(folder: &Path) {
    let file = File::options().create(true).append(true).open(filler_file(folder));
    let file = file.expect("an empty file needs no space");
    let (mut length, mut chunk) = (0, 1 << 30);
    while chunk >= 512 {
        match fallocate(&file, FallocateFlags::empty(), length, chunk) {
            Ok(()) => length += chunk,
            Err(Errno::NOSPC) => chunk /= 2,
            Err(error) => panic!("cannot fill {}: {error}", folder.display()),
        }
    }
}

/// Frees the space that [`fill`] allocated.
fn free(folder: &Path) {
    std::fs::remove_file(filler_file(folder)).expect("the disk was filled");
}

fn filler_file(folder: &Path) -> PathBuf {
    folder.join("filler")
}

/// Creates an empty folder as mount point.
fn mount_point() -> PathBuf {
    static DISKS: AtomicU32 = AtomicU32::new(0);
    assert!(
        geteuid().is_root(),
        "this test mounts a disk, which needs root: run it as root, for instance with sudo -E"
    );
    let parent = std::env::temp_dir().join("peernet-tests").join("disks");
    std::fs::create_dir_all(&parent).expect("the temporary folder is writable");
    remove_abandoned_disks(&parent);
    let number = DISKS.fetch_add(1, Ordering::Relaxed);
    let folder = parent.join(format!("{}-{number}", std::process::id()));
    std::fs::create_dir(&folder).expect("the temporary folder is writable");
    folder
}

/// Runs a command, and returns its output.
fn run(command: &str, arguments: &[&str]) -> String {
    let output = Command::new(command).args(arguments).output();
    let output = output.unwrap_or_else(|error| panic!("cannot start {command}: {error}"));
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command} {arguments:?}: {stderr}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn text(path: &Path) -> String {
    path.display().to_string()
}

/// Removes the disks of test processes that have ended.
fn remove_abandoned_disks(parent: &Path) {
    let folders = std::fs::read_dir(parent).into_iter().flatten().flatten();
    for folder in folders.map(|entry| entry.path()) {
        let name = folder.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let owner = name.split('-').next().unwrap_or_default();
        if !Path::new("/proc").join(owner).exists() {
            remove(&folder);
        }
    }
}

fn remove(folder: &Path) {
    // The file system is detached, so that a process with an open file does not keep it mounted.
    let _ = unmount(folder, UnmountFlags::DETACH);
    let _ = std::fs::remove_dir(folder);
    let _ = std::fs::remove_file(folder.with_extension("img"));
}

impl Drop for ImageDisk {
    fn drop(&mut self) {
        remove(&self.folder);
    }
}

impl Drop for SecondMount {
    fn drop(&mut self) {
        remove(&self.folder);
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        remove(&self.folder);
    }
}
