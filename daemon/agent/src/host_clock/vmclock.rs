//! Disruptions of the clocks that a hypervisor reports through `vmclock` devices of Linux (`linux/vmclock-abi.h`).
//!
//! A device contains a marker: a number that the hypervisor changes at each disruption.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Magic number "VCLK"; the whole structure is little-endian.
const MAGIC: u32 = 0x4b4c_4356;
const VERSION: u16 = 1;
/// Length in bytes of the structure up to the end of the marker: magic, size (32 bits each), version (16), two bytes
/// about the counter, sequence count (32), marker (64).
const STRUCTURE_BYTES: usize = 24;
/// Number of attempts to read a structure that is being changed. If all fail, the structure is read at the next check.
const ATTEMPTS: u32 = 8;

/// The devices, and their markers at the last check.
#[derive(Debug)]
pub(crate) struct Vmclock {
    devices: Vec<Device>,
}

#[derive(Debug)]
struct Device {
    path: PathBuf,
    file: File,
    /// Marker at the last check; `None` if it was never read.
    marker: Option<u64>,
}

impl Vmclock {
    /// Opens the devices `vmclock*` in a folder, such as `/dev`. A device that cannot be read is logged. Most hosts
    /// have no such device.
    pub(crate) fn open_all(dev: &Path) -> Self {
        let entries = std::fs::read_dir(dev).into_iter().flatten().flatten();
        let device_entries =
            entries.filter(|entry| entry.file_name().to_string_lossy().starts_with("vmclock"));
        let open = |path: PathBuf| match File::open(&path) {
            Ok(file) => Some(Device { path, file, marker: None }),
            Err(error) => {
                let device = path.display();
                tracing::warn!(
                    "cannot read {device}: {error}; disruptions of the clocks that the hypervisor reports there are not \
                     detected; allow this user to read the device"
                );
                None
            }
        };
        let mut vmclock =
            Self { devices: device_entries.map(|entry| entry.path()).filter_map(open).collect() };
        // The markers at the start are the baseline.
        let _ = vmclock.find_disrupted_device();
        vmclock
    }

    /// Reads the markers. Returns a device whose marker changed since the last check. A change means that the hardware
    /// counter was disrupted, for example because the virtual machine was moved.
    pub(crate) fn find_disrupted_device(&mut self) -> Option<&Path> {
        let mut disrupted = None;
        for device in &mut self.devices {
            match read(&device.file) {
                Ok(Some(marker)) => {
                    let previous = device.marker.replace(marker);
                    if previous.is_some_and(|previous| previous != marker) {
                        disrupted = Some(device.path.as_path());
                    }
                }
                Ok(None) => {}
                // The device stays in the list, because it may be readable later.
                Err(error) => tracing::debug!("cannot read {}: {error}", device.path.display()),
            }
        }
        disrupted
    }
}

/// Reads the marker; `None` while the structure is being changed.
///
/// The sequence count is odd during a change of the structure, and has another value after the change.
// Linux gives each reader a consistent copy of the structure. The count is checked nevertheless, in case another
// program provides the file.
fn read(file: &File) -> io::Result<Option<u64>> {
    let mut previous = read_structure(file)?;
    for _ in 0..ATTEMPTS {
        let current = read_structure(file)?;
        if previous == current && sequence_count(&current).is_multiple_of(2) {
            let [.., a, b, c, d, e, f, g, h] = current;
            return Ok(Some(u64::from_le_bytes([a, b, c, d, e, f, g, h])));
        }
        previous = current;
    }
    Ok(None)
}

fn read_structure(file: &File) -> io::Result<[u8; STRUCTURE_BYTES]> {
    let mut bytes = [0; STRUCTURE_BYTES];
    file.read_exact_at(&mut bytes, 0)?;
    let magic = u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    let version = u16::from_le_bytes([bytes[8], bytes[9]]);
    if (magic, version) != (MAGIC, VERSION) {
        let text = format!(
            "it is not a vmclock device: it has the magic number {magic:#x} and the version {version}"
        );
        return Err(io::Error::new(io::ErrorKind::InvalidData, text));
    }
    Ok(bytes)
}

const fn sequence_count(bytes: &[u8; STRUCTURE_BYTES]) -> u32 {
    u32::from_le_bytes([bytes[12], bytes[13], bytes[14], bytes[15]])
}

#[cfg(test)]
pub(super) mod tests {
    use std::fs::OpenOptions;
    use std::sync::atomic::{AtomicBool, Ordering};

    use super::*;

    /// Length of a whole structure in bytes; the fields after the marker are not read.
    const WHOLE_STRUCTURE_BYTES: usize = 104;

    /// Creates a device in a folder.
    pub(in crate::host_clock) fn create_device(folder: &Path, marker: u64) -> File {
        let path = folder.join("vmclock0");
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(true).open(path);
        let file = file.expect("made");
        let mut bytes = [0; WHOLE_STRUCTURE_BYTES];
        bytes[..4].copy_from_slice(&MAGIC.to_le_bytes());
        bytes[4..8].copy_from_slice(&4096_u32.to_le_bytes());
        bytes[8..10].copy_from_slice(&VERSION.to_le_bytes());
        bytes[10] = 1; // VMCLOCK_COUNTER_X86_TSC
        bytes[16..24].copy_from_slice(&marker.to_le_bytes());
        file.write_all_at(&bytes, 0).expect("written");
        file
    }

    /// Changes the marker as a hypervisor does: the sequence count is odd during the change.
    pub(in crate::host_clock) fn disrupt(file: &File, sequence: u32, marker: u64) {
        let write = |bytes: &[u8], at| file.write_all_at(bytes, at).expect("written");
        write(&(sequence + 1).to_le_bytes(), 12);
        for (at, byte) in (16..).zip(marker.to_le_bytes()) {
            write(&[byte], at);
        }
        write(&(sequence + 2).to_le_bytes(), 12);
    }

    #[test]
    fn changed_marker_is_reported_once() {
        let dev = tempfile::tempdir().expect("a folder");
        assert_eq!(Vmclock::open_all(dev.path()).find_disrupted_device(), None, "there is no device");
        let file = create_device(dev.path(), 7);
        let mut vmclock = Vmclock::open_all(dev.path());
        assert_eq!(vmclock.find_disrupted_device(), None);
        disrupt(&file, 0, 8);
        assert_eq!(vmclock.find_disrupted_device(), Some(dev.path().join("vmclock0").as_path()));
        assert_eq!(vmclock.find_disrupted_device(), None);
    }

    #[test]
    fn changing_marker_is_reported_after_the_change() {
        let dev = tempfile::tempdir().expect("a folder");
        let file = create_device(dev.path(), 7);
        let mut vmclock = Vmclock::open_all(dev.path());
        disrupt(&file, 0, 8);
        file.write_all_at(&3_u32.to_le_bytes(), 12).expect("written");
        assert_eq!(vmclock.find_disrupted_device(), None);
        file.write_all_at(&4_u32.to_le_bytes(), 12).expect("written");
        assert!(vmclock.find_disrupted_device().is_some());
    }

    #[test]
    fn file_of_another_format_reports_nothing() {
        for (at, byte) in [(0, b'X'), (8, 2)] {
            let dev = tempfile::tempdir().expect("a folder");
            let file = create_device(dev.path(), 7);
            file.write_all_at(&[byte], at).expect("written");
            let mut vmclock = Vmclock::open_all(dev.path());
            disrupt(&file, 0, 8);
            assert_eq!(vmclock.find_disrupted_device(), None);
        }
        let dev = tempfile::tempdir().expect("a folder");
        std::fs::write(dev.path().join("vmclock0"), [0; STRUCTURE_BYTES - 1]).expect("written");
        assert_eq!(Vmclock::open_all(dev.path()).find_disrupted_device(), None);
    }

    #[test]
    fn half_changed_marker_is_never_returned() {
        let dev = tempfile::tempdir().expect("a folder");
        let file = create_device(dev.path(), 0);
        let has_ended = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let mut changes = 0_u32;
                while !has_ended.load(Ordering::Relaxed) {
                    changes += 1;
                    let byte = u64::from(changes % 256);
                    disrupt(&file, 2 * changes, byte * 0x0101_0101_0101_0101);
                }
            });
            let device = File::open(dev.path().join("vmclock0")).expect("it is there");
            for _ in 0..5_000 {
                if let Some(marker) = read(&device).expect("the file is a vmclock device") {
                    assert_eq!(marker, (marker & 0xff) * 0x0101_0101_0101_0101, "{marker:x}");
                }
            }
            has_ended.store(true, Ordering::Relaxed);
        });
    }
}
