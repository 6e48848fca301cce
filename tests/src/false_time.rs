//! False wall clock that libfaketime shows to a process instead of the kernel's wall clock.

use std::path::{Path, PathBuf};

use peernet_clock::Span;

/// A false time that processes with its [`environment`](Self::environment) see.
#[derive(Debug)]
pub struct FalseTime {
    library: String,
    file: PathBuf,
}

impl FalseTime {
    /// Creates a false time that is `ahead` of the kernel's wall clock. A file in `folder` holds the difference.
    ///
    /// # Panics
    /// If libfaketime is not installed.
    pub fn new(folder: &Path, ahead: Span) -> Self {
        // Debian installs the library in a folder per architecture.
        let folders = std::fs::read_dir("/usr/lib").expect("every Linux has /usr/lib").flatten();
        let mut libraries = folders
            .map(|folder| folder.path().join("faketime/libfaketimeMT.so.1"))
            .filter(|path| path.exists());
        let library = libraries.next().expect("libfaketime is installed: run `deploy/install-tools.sh test`");
        std::fs::create_dir_all(folder).expect("the temporary folder is writable");
        let false_time = Self { library: library.display().to_string(), file: folder.join("ahead") };
        false_time.show(ahead);
        false_time
    }

    /// Changes the false time to `ahead` of the kernel's wall clock. Processes see the change within a second.
    ///
    /// # Panics
    /// If the file cannot be written.
    pub fn show(&self, ahead: Span) {
        let new_file = self.file.with_extension("new");
        std::fs::write(&new_file, format!("{:+}s\n", ahead.seconds())).expect("the folder is writable");
        std::fs::rename(new_file, &self.file).expect("the folder is writable");
    }

    /// Returns the environment variables for a process that should see this time.
    ///
    /// # Panics
    /// If the folder's name is not Unicode.
    pub fn environment(&self) -> [(&str, &str); 4] {
        [
            ("LD_PRELOAD", &self.library),
            ("FAKETIME_TIMESTAMP_FILE", self.file.to_str().expect("the name of a temporary folder is ASCII")),
            ("FAKETIME_CACHE_DURATION", "1"),
            ("DONT_FAKE_MONOTONIC", "1"),
        ]
    }
}
