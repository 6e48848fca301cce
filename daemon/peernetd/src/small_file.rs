//! Small text files that the command line names.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// Bytes of the largest file that people write by hand.
pub const LARGEST: u64 = 1 << 20;

/// The text of a regular file of at most `largest` bytes: a device, a pipe or a recording given by mistake would be
/// read, or waited for, without an end.
///
/// # Errors
/// When it cannot be read, is no regular file, is larger, or is no UTF-8.
pub fn read(path: &Path, largest: u64) -> io::Result<String> {
    // Before it is opened: to open a pipe that nobody writes to takes for ever.
    if !path.metadata()?.is_file() {
        return Err(io::Error::other("it is no regular file: is this the right file?"));
    }
    let mut bytes = Vec::new();
    File::open(path)?.take(largest + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > largest {
        return Err(io::Error::other(format!("it is larger than {largest} bytes: is this the right file?")));
    }
    String::from_utf8(bytes).map_err(|_| io::Error::new(io::ErrorKind::InvalidData, "it is no UTF-8 text"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regular_files_of_reasonable_size_are_read_and_nothing_else() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("a.toml");
        std::fs::write(&file, "four").expect("writable");
        assert_eq!(read(&file, 4).expect("fits"), "four");
        let told = |path: &Path| read(path, 3).expect_err("refused").to_string();
        assert!(told(&file).contains("larger than 3 bytes"), "{}", told(&file));
        for other in [Path::new("/dev/zero"), folder.path()] {
            assert!(told(other).contains("no regular file"), "{}", told(other));
        }
        let missing = read(&folder.path().join("b"), 3).expect_err("not there");
        assert_eq!(missing.kind(), io::ErrorKind::NotFound);
        std::fs::write(&file, [0xff, 0xfe]).expect("writable");
        assert!(told(&file).contains("no UTF-8"), "{}", told(&file));
    }
}
