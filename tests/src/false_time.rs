//! A wall clock that a process is shown in place of the kernel's, by libfaketime.

use std::path::{Path, PathBuf};

use peernet_clock::Span;

/// The time that processes are shown which were started with its environment.
#[derive(Debug)]
pub struct FalseTime {
    library: String,
    file: PathBuf,
}

impl FalseTime {
    /// A time that is ahead of the kernel's; a file in the folder says by how much.
    ///
    /// # Panics
    /// When libfaketime is not installed.
    pub fn new(folder: &Path, ahead: Span) -> Self {
        // Debian keeps it in a folder of its own, one per architecture.
        let folders = std::fs::read_dir("/usr/lib").expect("every Linux has /usr/lib").flatten();
        let mut found = folders
            .map(|folder| folder.path().join("faketime/libfaketimeMT.so.1"))
            .filter(|path| path.exists());
        let library = found.next().expect("libfaketime is installed: run `deploy/install-tools.sh test`");
        std::fs::create_dir_all(folder).expect("the temporary folder is writable");
        let time = Self { library: library.display().to_string(), file: folder.join("ahead") };
        time.show(ahead);
        time
    }

    /// Shows another time from within a second on.
    ///
    /// # Panics
    /// When the file cannot be written.
    pub fn show(&self, ahead: Span) {
        let new = self.file.with_extension("new");
        std::fs::write(&new, format!("{:+}s\n", ahead.seconds())).expect("the folder is writable");
        std::fs::rename(new, &self.file).expect("the folder is writable");
    }

    /// What a process is started with that is to see it.
    ///
    /// # Panics
    /// When the folder's name is not Unicode.
    pub fn environment(&self) -> [(&str, &str); 4] {
        [
            ("LD_PRELOAD", &self.library),
            ("FAKETIME_TIMESTAMP_FILE", self.file.to_str().expect("the name of a temporary folder is ASCII")),
            ("FAKETIME_CACHE_DURATION", "1"),
            ("DONT_FAKE_MONOTONIC", "1"),
        ]
    }
}
