//! SHA-256 of files, which shows whether two runs used the same files.

use std::fs::{File, Metadata};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use rustix::fs::{Mode, OFlags};
use sha2::{Digest, Sha256};

use peernet_sample::printable_line;

/// Size of the largest file of custom code, and of the largest data set, whose content is hashed, bytes (256 MiB).
// Facts are read before a run. Hashing more would delay the run by more than a second.
pub const MAX_HASHED_BYTES: u64 = 256 << 20;

/// Returns the SHA-256 (FIPS 180-4) of everything that `reader` yields, in hexadecimal.
///
/// # Errors
/// If reading fails.
pub fn sha256(mut reader: impl Read) -> io::Result<String> {
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 1 << 16];
    loop {
        match reader.read(&mut buffer) {
            Ok(0) => break,
            Ok(count) => hasher.update(&buffer[..count]),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Returns the name and value of a run's fact about files (`Sensor files`, `camera.py SHA-256 …`); `None` without
/// files.
pub(crate) fn files_fact(role: &str, files: &[PathBuf]) -> Option<(String, String)> {
    let descriptions: Vec<String> = files.iter().map(|file| describe_with_hash(file)).collect();
    (!descriptions.is_empty()).then(|| (format!("{role} files"), descriptions.join(", ")))
}

/// Returns a file's name with its hash (`camera.py SHA-256 …`), or with the reason why the file has no hash.
pub fn describe_with_hash(file: &Path) -> String {
    let name = file.display().to_string();
    let name = printable_line(&name);
    match hash_file(file) {
        Ok(hash) => format!("{name} {hash}"),
        Err(error) => format!("{name} (cannot be read: {error})"),
    }
}

/// Returns `SHA-256 …`, or the size of a file that is too large to be hashed.
fn hash_file(file: &Path) -> io::Result<String> {
    // The type is checked twice: before opening, because opening a device may have effects, and after opening, because
    // the file may have been replaced in between.
    let regular_length = |metadata: Metadata| match metadata.is_file() {
        true => Ok(metadata.len()),
        false => Err(io::Error::other("it is not a regular file")),
    };
    regular_length(file.metadata()?)?;
    // Opening a named pipe would otherwise wait for a writer.
    let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let opened = File::from(rustix::fs::open(file, flags, Mode::empty())?);
    let length = regular_length(opened.metadata()?)?;
    if length > MAX_HASHED_BYTES {
        return Ok(format!("of {length} bytes, not hashed"));
    }
    // At most `length` bytes are read: a file in /proc has length 0, and reading it may block forever.
    sha256(opened.take(length)).map(|hash| format!("SHA-256 {hash}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_described_with_hash() {
        let folder = tempfile::tempdir().expect("a folder");
        let (file, large) = (folder.path().join("own.py"), folder.path().join("weights"));
        std::fs::write(&file, "abc").expect("writable");
        File::create(&large).and_then(|file| file.set_len(MAX_HASHED_BYTES + 1)).expect("writable");
        let missing = folder.path().join("none");
        let files = [file.clone(), large.clone(), missing.clone()];
        let (name, description) = files_fact("Sensor", &files).expect("three files are described");
        assert_eq!(name, "Sensor files");
        // The large file gives two entries, because its description contains a comma.
        let entries: Vec<&str> = description.split(", ").collect();
        // Example in FIPS 180-4.
        let expected_hash = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(entries[0], format!("{} SHA-256 {expected_hash}", file.display()));
        assert_eq!(
            &entries[1..],
            [
                format!("{} of 268435457 bytes", large.display()).as_str(),
                "not hashed",
                format!("{} (cannot be read: No such file or directory (os error 2))", missing.display())
                    .as_str(),
            ]
        );
        assert_eq!(files_fact("Sensor", &[]), None);
    }

    #[test]
    fn irregular_files_are_not_hashed() {
        let folder = tempfile::tempdir().expect("a folder");
        let pipe = folder.path().join("pipe");
        rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, Mode::RWXU).expect("can be made");
        let expected = format!("{} (cannot be read: it is not a regular file)", pipe.display());
        assert_eq!(describe_with_hash(&pipe), expected);
        // The length of `/proc/self/status` is 0, although the file has contents. Reading `/proc/kmsg` would wait for
        // the kernel's next message.
        let empty_hash = sha256(io::empty()).expect("reads");
        let description = describe_with_hash(Path::new("/proc/self/status"));
        assert_eq!(description, format!("/proc/self/status SHA-256 {empty_hash}"));
        let messages = describe_with_hash(Path::new("/proc/kmsg"));
        assert!(messages.ends_with(&empty_hash) || messages.contains("cannot be read"), "{messages}");
    }
}
