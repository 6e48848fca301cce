//! Reading of small text files that the command line names or that are found in folders.

use std::fs::File;
use std::io::{self, Read};
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

/// Size in bytes of the largest file that people write by hand.
pub const MAX_BYTES: u64 = 1 << 20;

/// Reads a regular file or a pipe of at most `max_bytes` bytes.
///
/// A device, a terminal or a recording that is named by mistake could be read without an end, so the kind of file and
/// the size are limited. A pipe is `<(…)` or `/dev/stdin` of a shell; it can be read once, and is read until its writer
/// has closed it.
///
/// # Errors
/// When the file cannot be read, is neither file nor pipe, is larger, or is not UTF-8.
pub fn read(path: &Path, max_bytes: u64) -> io::Result<String> {
    // The kind is checked before the file is opened: opening some devices has an effect.
    let kind = path.metadata()?.file_type();
    if !kind.is_file() && !kind.is_fifo() {
        return Err(io::Error::other("it is neither a regular file nor a pipe: is this the right file?"));
    }
    read_text(path, max_bytes)
}

/// Reads a regular file of at most `max_bytes` bytes. A pipe is refused: this function reads files that were found in a
/// folder, and a pipe found there may have no writer, so that reading would wait for ever.
///
/// # Errors
/// When the file cannot be read, is no regular file, is larger, or is not UTF-8.
pub fn read_regular_file(path: &Path, max_bytes: u64) -> io::Result<String> {
    if !path.metadata()?.is_file() {
        return Err(io::Error::other("it is not a regular file"));
    }
    read_text(path, max_bytes)
}

fn read_text(path: &Path, max_bytes: u64) -> io::Result<String> {
    let mut bytes = Vec::new();
    // One byte more than allowed is read, which shows that the file is too large.
    File::open(path)?.take(max_bytes + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_bytes {
        return Err(io::Error::other(format!(
            "it is larger than {max_bytes} bytes: is this the right file?"
        )));
    }
    String::from_utf8(bytes).map_err(|_| io::Error::new(io::ErrorKind::InvalidData, "it is not UTF-8 text"))
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::os::fd::AsRawFd;

    use rustix::fs::{CWD, FileType, Mode, mknodat};

    use super::*;

    fn error_text(path: &Path) -> String {
        read(path, 3).expect_err("refused").to_string()
    }

    #[test]
    fn large_file_device_and_folder_are_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("a.toml");
        std::fs::write(&file, "four").expect("writable");
        assert_eq!(read(&file, 4).expect("fits"), "four");
        assert!(error_text(&file).contains("larger than 3 bytes"), "{}", error_text(&file));
        for other in [Path::new("/dev/zero"), folder.path()] {
            assert!(error_text(other).contains("neither a regular file nor a pipe"), "{}", error_text(other));
        }
        let missing = read(&folder.path().join("b"), 3).expect_err("not there");
        assert_eq!(missing.kind(), io::ErrorKind::NotFound);
        std::fs::write(&file, [0xff, 0xfe]).expect("writable");
        assert!(error_text(&file).contains("not UTF-8"), "{}", error_text(&file));
    }

    #[test]
    fn found_pipe_is_refused_without_waiting() {
        let folder = tempfile::tempdir().expect("a folder");
        let (file, pipe) = (folder.path().join("file"), folder.path().join("pipe"));
        std::fs::write(&file, "four").expect("writable");
        mknodat(CWD, &pipe, FileType::Fifo, Mode::RUSR, 0).expect("a pipe");
        assert_eq!(read_regular_file(&file, 4).expect("fits"), "four");
        for other in [pipe.as_path(), folder.path()] {
            assert!(
                read_regular_file(other, 4).expect_err("refused").to_string().contains("not a regular file")
            );
        }
    }

    #[test]
    fn pipe_is_read_to_end_or_limit() {
        let read_from_pipe = |text: &'static [u8], max_bytes: u64| {
            let (reader, mut writer) = io::pipe().expect("a pipe");
            let writer_thread = std::thread::spawn(move || writer.write_all(text));
            let path = format!("/dev/fd/{}", reader.as_raw_fd());
            let content = read(Path::new(&path), max_bytes);
            drop(reader);
            let written = writer_thread.join().expect("no panic");
            (content, written)
        };
        let (content, written) = read_from_pipe(b"four", 4);
        assert!(content.expect("fits") == "four" && written.is_ok());
        // The reader closes the pipe after the limit, so that a writer without an end gets an error.
        let (content, written) = read_from_pipe(&[b'x'; 1 << 20], 3);
        assert!(content.expect_err("refused").to_string().contains("larger than 3 bytes"));
        assert_eq!(written.map_err(|error| error.kind()), Err(io::ErrorKind::BrokenPipe));
    }
}
