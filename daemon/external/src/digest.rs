//! SHA-256 of files, by which others recognise that they have the same.

use std::fs::{File, Metadata};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use rustix::fs::{Mode, OFlags};
use sha2::{Digest, Sha256};

use peernet_sample::printable_line;

/// Bytes of the largest file of a user's code that is hashed: 256 MiB.
const LARGEST: u64 = 256 << 20;

/// SHA-256 (FIPS 180-4) of all that is read, in hexadecimal.
///
/// # Errors
/// When reading fails.
pub fn sha256(mut from: impl Read) -> io::Result<String> {
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 1 << 16];
    loop {
        match from.read(&mut buffer) {
            Ok(0) => break,
            Ok(count) => hasher.update(&buffer[..count]),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

/// The fact (`Sensor files`, `camera.py SHA-256 …`) of some files; `None` of none.
pub(crate) fn fact(role: &str, files: &[PathBuf]) -> Option<(String, String)> {
    let words: Vec<String> = files.iter().map(|file| identified(file)).collect();
    (!words.is_empty()).then(|| (format!("{role} files"), words.join(", ")))
}

/// A file with its hash, in words: `camera.py SHA-256 …`, or why it has none.
pub fn identified(file: &Path) -> String {
    let name = file.display().to_string();
    let name = printable_line(&name);
    match hashed(file) {
        Ok(words) => format!("{name} {words}"),
        Err(error) => format!("{name} (cannot be read: {error})"),
    }
}

fn hashed(file: &Path) -> io::Result<String> {
    // Both before it is opened, since to open a device may do something, and after, since another may have taken its place.
    let regular = |about: Metadata| match about.is_file() {
        true => Ok(about.len()),
        false => Err(io::Error::other("it is not a regular file")),
    };
    regular(file.metadata()?)?;
    // To open a pipe would wait for its writer.
    let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let opened = File::from(rustix::fs::open(file, flags, Mode::empty())?);
    let length = regular(opened.metadata()?)?;
    if length > LARGEST {
        return Ok(format!("of {length} bytes, not hashed"));
    }
    // To read more than there was may wait for ever, as of files of the kernel's, whose length is 0.
    sha256(opened.take(length)).map(|hash| format!("SHA-256 {hash}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_told_with_the_hash_of_sha256sum() {
        let folder = tempfile::tempdir().expect("a folder");
        let (file, large) = (folder.path().join("own.py"), folder.path().join("weights"));
        std::fs::write(&file, "abc").expect("writable");
        File::create(&large).and_then(|file| file.set_len(LARGEST + 1)).expect("writable");
        let missing = folder.path().join("none");
        let files = [file.clone(), large.clone(), missing.clone()];
        let (name, told) = fact("Sensor", &files).expect("there are some");
        assert_eq!(name, "Sensor files");
        let parts: Vec<&str> = told.split(", ").collect();
        // FIPS 180-4's own example.
        let known = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(parts[0], format!("{} SHA-256 {known}", file.display()));
        assert_eq!(
            &parts[1..],
            [
                format!("{} of 268435457 bytes", large.display()).as_str(),
                "not hashed",
                format!("{} (cannot be read: No such file or directory (os error 2))", missing.display())
                    .as_str(),
            ]
        );
        assert_eq!(fact("Sensor", &[]), None);
    }

    #[test]
    fn nothing_is_read_that_may_have_no_end() {
        let folder = tempfile::tempdir().expect("a folder");
        let pipe = folder.path().join("pipe");
        rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, Mode::RWXU).expect("can be made");
        let refused = format!("{} (cannot be read: it is not a regular file)", pipe.display());
        assert_eq!(identified(&pipe), refused);
        // Of length 0, though there is something to read; to read the kernel's messages waits for the next.
        let nothing = sha256(io::empty()).expect("reads");
        let told = identified(Path::new("/proc/self/status"));
        assert_eq!(told, format!("/proc/self/status SHA-256 {nothing}"));
        let messages = identified(Path::new("/proc/kmsg"));
        assert!(messages.ends_with(&nothing) || messages.contains("cannot be read"), "{messages}");
    }
}
