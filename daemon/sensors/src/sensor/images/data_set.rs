//! Description of a data set; copies of a data set have the same description.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;

use peernet_external::{MAX_HASHED_BYTES, sha256};

/// Returns the number of files, their number of bytes and their hash, as text. Each file is given with its name in the
/// data set.
///
/// The hash is the SHA-256 of the list that `sha256sum` prints for the files, sorted by name as bytes. For a data set
/// of more than [`MAX_HASHED_BYTES`] bytes, it is the SHA-256 of the list of sizes and names (`stat -c '%s  %n'`).
pub(super) fn describe_files<'a>(files: impl Iterator<Item = (&'a OsStr, &'a Path)>) -> String {
    let mut files: Vec<_> = files.collect();
    // File systems list the files of a folder in any order, but copies of a data set must have equal hashes.
    files.sort_unstable();
    let count = files.len();
    let count = if count == 1 { "1 file".to_owned() } else { format!("{count} files") };
    hash_files(&files, MAX_HASHED_BYTES).map_or_else(
        // A fact never stops a run. A file that cannot be read fails its own sample later, with the same error.
        |error| format!("{count}, no SHA-256: {error}"),
        |(bytes, hash)| format!("{count}, {bytes} bytes, {hash}"),
    )
}

/// Returns the number of bytes of all files, and their hash with the name of what was hashed.
fn hash_files(files: &[(&OsStr, &Path)], max_hashed_bytes: u64) -> io::Result<(u64, String)> {
    let size = |(_, file): &(&OsStr, &Path)| Ok(fs::metadata(file)?.len());
    let sizes = files.iter().map(size).collect::<io::Result<Vec<u64>>>()?;
    let bytes = sizes.iter().sum();
    let (is_small, mut list) = (bytes <= max_hashed_bytes, Vec::new());
    for ((name, file), size) in files.iter().zip(sizes) {
        // No more than the size is read, so that a file that grows at the same time does not delay the run.
        let hash_or_size = if is_small { sha256(File::open(file)?.take(size))? } else { size.to_string() };
        list.extend([hash_or_size.as_bytes(), b"  ", name.as_encoded_bytes(), b"\n"].concat());
    }
    let hashed_content = if is_small { "SHA-256" } else { "SHA-256 of sizes and names only" };
    Ok((bytes, format!("{hashed_content} {}", sha256(list.as_slice())?)))
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    /// Writes files with these names and contents, and hashes them.
    fn hash_of(files: &[(&str, &str)], max_hashed_bytes: u64) -> io::Result<(u64, String)> {
        let folder = tempfile::tempdir().expect("a folder");
        let files_on_disk = files.iter().map(|(name, content)| {
            let path = folder.path().join(name);
            fs::write(&path, content).expect("writable");
            (OsStr::new(*name), path)
        });
        let files_on_disk: Vec<(&OsStr, PathBuf)> = files_on_disk.collect();
        hash_files(
            &files_on_disk.iter().map(|(name, path)| (*name, path.as_path())).collect::<Vec<_>>(),
            max_hashed_bytes,
        )
    }

    #[test]
    fn data_set_hash_equals_output_of_sha256sum() {
        let files = [("a b.jpg", "one"), ("c.png", "three")];
        // printf one > 'a b.jpg'; printf three > c.png; sha256sum * | sha256sum
        let expected_hash = "80a1a4de32989a8bc607fd2b8ec1b0b01bb8b8e6c1c719e5ddcda90111e72296";
        assert_eq!(hash_of(&files, 8).expect("is read"), (8, format!("SHA-256 {expected_hash}")));
        // stat -c '%s  %n' * | sha256sum
        let expected_hash = "cd3d3ffc75f00c9c365b509f72c56ca99a188e525a7e9025ee2e7de46533cb4a";
        let description = hash_of(&files, 7).expect("is read");
        assert_eq!(description, (8, format!("SHA-256 of sizes and names only {expected_hash}")));
    }

    #[test]
    fn description_depends_on_contents_and_names_not_order() {
        let folder = tempfile::tempdir().expect("a folder");
        let write =
            |name: &str, content: &str| fs::write(folder.path().join(name), content).expect("writable");
        write("a", "one");
        write("b", "two");
        let (a, b) = (folder.path().join("a"), folder.path().join("b"));
        let description = |files: &[(&str, &Path)]| {
            describe_files(files.iter().map(|(name, file)| (OsStr::new(*name), *file)))
        };
        let first = description(&[("a", &a), ("b", &b)]);
        assert!(first.starts_with("2 files, 6 bytes, SHA-256 "), "{first}");
        assert_eq!(description(&[("b", &b), ("a", &a)]), first);
        assert_ne!(description(&[("c", &a), ("b", &b)]), first);
        write("b", "twi");
        assert_ne!(description(&[("a", &a), ("b", &b)]), first);
        fs::remove_file(&b).expect("removed");
        let missing = description(&[("b", &b)]);
        assert!(missing.starts_with("1 file, no SHA-256: No such file"), "{missing}");
    }
}
