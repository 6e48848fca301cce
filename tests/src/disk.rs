//! Disks of a test's own: one that is small enough to be filled, one that can be unmounted and set read-only.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::Errno;
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
        let folder = mount_point();
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
    pub fn fill(&self) {
        fill(&self.folder);
    }

    /// Gives that room back.
    pub fn free(&self) {
        free(&self.folder);
    }
}

/// An ext4 file system in a file, on a loop device. Unmounted when dropped; one that a killed test left behind goes with
/// the next.
#[derive(Debug)]
pub struct ImageDisk {
    folder: PathBuf,
    image: PathBuf,
}

/// A disk's folder that is mounted in a second place.
#[derive(Debug)]
pub struct SecondMount {
    folder: PathBuf,
}

impl ImageDisk {
    /// Makes and mounts a disk of so many bytes.
    ///
    /// # Panics
    /// When not run as root, or the kernel has no loop devices.
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

    /// Where it is mounted.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Mounts it.
    pub fn mount(&self) {
        run("mount", &["-o", "loop", &text(&self.image), &text(&self.folder)]);
    }

    /// Unmounts it from its folder at once; what has files open keeps it in use.
    ///
    /// # Panics
    /// When it is not mounted.
    pub fn unmount(&self) {
        unmount(&self.folder, UnmountFlags::DETACH).expect("it is mounted");
    }

    /// Takes all the room that is left.
    pub fn fill(&self) {
        fill(&self.folder);
    }

    /// Gives that room back.
    pub fn free(&self) {
        free(&self.folder);
    }

    /// Whether its device still has a file system on it that is in use.
    pub fn is_in_use(&self) -> bool {
        !run("losetup", &["--associated", &text(&self.image)]).trim().is_empty()
    }

    /// Mounts it anew with an option, such as `ro`.
    ///
    /// # Panics
    /// When that is refused: a file is open for writing.
    pub fn remount(&self, option: &str) {
        run("mount", &["-o", &format!("remount,{option}"), &text(&self.folder)]);
    }

    /// Refuses or allows all writing to those of some files that exist, also through descriptors that are open, and
    /// for root.
    pub fn set_immutable(&self, files: &[PathBuf], immutable: bool) {
        for file in files.iter().filter(|file| file.exists()) {
            run("chattr", &[if immutable { "+i" } else { "-i" }, &text(file)]);
        }
    }

    /// Mounts it in a second place.
    pub fn mounted_elsewhere(&self) -> SecondMount {
        let second = SecondMount { folder: mount_point() };
        run("mount", &["--bind", &text(&self.folder), &text(&second.folder)]);
        second
    }
}

impl SecondMount {
    /// The second place.
    pub fn folder(&self) -> &Path {
        &self.folder
    }
}

/// Takes all the room of the disk that a folder is on.
fn fill(folder: &Path) {
    let file = File::options().create(true).append(true).open(ballast(folder));
    let file = file.expect("an empty file needs no room");
    let (mut length, mut part) = (0, 1 << 30);
    while part >= 512 {
        match fallocate(&file, FallocateFlags::empty(), length, part) {
            Ok(()) => length += part,
            Err(Errno::NOSPC) => part /= 2,
            Err(error) => panic!("cannot fill {}: {error}", folder.display()),
        }
    }
}

/// Gives that room back.
fn free(folder: &Path) {
    std::fs::remove_file(ballast(folder)).expect("the disk was filled");
}

fn ballast(folder: &Path) -> PathBuf {
    folder.join("ballast")
}

/// An empty folder to mount something in.
fn mount_point() -> PathBuf {
    static DISKS: AtomicU32 = AtomicU32::new(0);
    assert!(
        geteuid().is_root(),
        "this test mounts a disk, which needs root: run it as root, for instance with sudo -E"
    );
    let all = std::env::temp_dir().join("peernet-tests").join("disks");
    std::fs::create_dir_all(&all).expect("the temporary folder is writable");
    sweep(&all);
    let number = DISKS.fetch_add(1, Ordering::Relaxed);
    let folder = all.join(format!("{}-{number}", std::process::id()));
    std::fs::create_dir(&folder).expect("the temporary folder is writable");
    folder
}

/// What a command of the system prints.
fn run(command: &str, arguments: &[&str]) -> String {
    let output = Command::new(command).args(arguments).output();
    let output = output.unwrap_or_else(|error| panic!("cannot start {command}: {error}"));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command} {arguments:?}: {said}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn text(path: &Path) -> String {
    path.display().to_string()
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
