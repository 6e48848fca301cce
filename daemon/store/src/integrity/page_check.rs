//! Search for malformed pages in a database's main file.

use std::collections::{HashMap, HashSet};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::log_pages::{LogPages, log_path};
use super::pages::{PageFile, be32};

/// One pass over the file, some pages at a time.
///
/// A page of a b-tree is well-formed if its header, its cell pointers and the headers of all its records are
/// well-formed. Overflow pages (on which long records continue) and free pages may contain any bytes. The pages that
/// refer to them show that they are overflow pages or free pages.
#[derive(Debug)]
pub(crate) struct PageCheck {
    file: PageFile,
    log: PathBuf,
    /// Number of the page that is examined next.
    next: u32,
    /// Pages that are not well-formed pages of a b-tree, with the number in their first four bytes. In an overflow page
    /// this number is the next overflow page.
    other_pages: HashMap<u32, u32>,
    /// Overflow pages to which other pages refer. They are still to be removed from `other_pages`.
    overflow_pages: Vec<u32>,
}

impl PageCheck {
    /// Starts a pass over the open file; `log` is the path of its write-ahead log. `None` if the file has no header of
    /// a database.
    ///
    /// # Errors
    /// When a file cannot be read. This applies to all functions here that return an `io::Result`.
    pub(crate) fn start(database: Arc<File>, log: PathBuf) -> io::Result<Option<Self>> {
        Ok(PageFile::from_file(database)?.map(|file| Self {
            file,
            log,
            next: 1,
            other_pages: HashMap::new(),
            overflow_pages: Vec::new(),
        }))
    }

    /// Makes a whole pass over a file. Returns the numbers of malformed pages. No connection of this process may have
    /// the file open, because this function closes its own descriptor of the file, which would release SQLite's locks
    /// (see [`PageFile::open`]).
    pub(crate) fn find_malformed(database: &Path) -> io::Result<Vec<u32>> {
        let file = Arc::new(File::open(database)?);
        let Some(mut check) = Self::start(file, log_path(database))? else { return Ok(vec![1]) };
        while check.step(1 << 20)? {}
        check.finish()
    }

    /// Examines the next pages, about `bytes` bytes. Returns whether more pages remain.
    pub(crate) fn step(&mut self, bytes: u64) -> io::Result<bool> {
        let first = self.next;
        let count = (bytes / self.file.page_bytes as u64).max(1);
        let read = self.file.read(first, u32::try_from(count).unwrap_or(u32::MAX))?;
        for (number, page) in (first..).zip(read.chunks_exact(self.file.page_bytes)) {
            self.next = number + 1;
            match self.file.well_formed_page(number, page.to_vec(), self.file.page_count) {
                Some(page) => self.overflow_pages.extend(page.overflow_pages()),
                // SQLite stores nothing in this page.
                None if self.file.is_lock_page(number) => {}
                None => {
                    self.other_pages.insert(number, be32(page, 0));
                }
            }
        }
        Ok(self.next <= self.file.page_count)
    }

    /// Returns the malformed pages that are in use.
    ///
    /// While an aggregator stores, a checkpoint may be in progress, so the main file may mix pages of different times.
    /// Therefore an overflow page is also in use if a page in the write-ahead log refers to it. A page is returned only
    /// if it is malformed when it is read a second time, too. The result may nevertheless contain pages whose contents
    /// moved during the pass; another pass does not find these pages malformed.
    pub(crate) fn finish(mut self) -> io::Result<Vec<u32>> {
        let missing_page = self.file.first_missing_page()?;
        // The write-ahead log is read only if a page remains that may be malformed, or if a page is missing.
        self.follow_overflows(None)?;
        if self.other_pages.is_empty() && missing_page.is_none() {
            return Ok(Vec::new());
        }
        let log = LogPages::open(&self.log, self.file.page_bytes)?;
        // The file may have grown, and the write-ahead log may have pages beyond the end of the file.
        self.file.update_length()?;
        let last = log.iter().flat_map(LogPages::numbers).max().unwrap_or(0).max(self.file.page_count);
        for number in log.iter().flat_map(LogPages::numbers) {
            let page = log.as_ref().map_or(Ok(None), |log| log.read(number))?;
            let page = page.and_then(|page| self.file.well_formed_page(number, page, last));
            self.overflow_pages.extend(page.iter().flat_map(|page| page.overflow_pages()));
        }
        for number in
            Vec::from_iter(self.other_pages.keys().copied().filter(|number| self.file.contains(*number)))
        {
            let page = self.file.read(number, 1)?;
            if let Some(page) = self.file.well_formed_page(number, page, last) {
                self.other_pages.remove(&number);
                self.overflow_pages.extend(page.overflow_pages());
            }
        }
        self.follow_overflows(log.as_ref())?;
        // A page is free if it is in the main file's list of free pages, or in the list as SQLite sees it.
        for free_pages in [self.file.free_pages(|_| Ok(None))?, self.free_pages_with_log(log.as_ref())?] {
            for number in free_pages.into_iter().flatten() {
                self.other_pages.remove(&number);
            }
        }
        let mut malformed: Vec<u32> = self.other_pages.keys().copied().chain(missing_page).collect();
        if let Some(log) = &log
            && malformed.iter().any(|number| log.contains(*number))
            && !self.is_checkpointed(log)?
        {
            // Until the log is checkpointed, SQLite reads each page that is in the log from the log. The main file may
            // have an older version of this page, a sparse range, or nothing yet.
            malformed.retain(|number| !log.contains(*number));
        }
        malformed.sort_unstable();
        Ok(malformed)
    }

    /// Removes the overflow pages that are in use from the pages that may be malformed. If `log` is given, the newer
    /// versions of overflow pages in the write-ahead log are followed, too. Does not report a chain of overflow pages
    /// that ends early, at a malformed or missing page.
    fn follow_overflows(&mut self, log: Option<&LogPages>) -> io::Result<()> {
        // Each page is read from the log once, so following a chain that refers to itself ends.
        let mut seen_in_log = HashSet::new();
        while let Some(page) = self.overflow_pages.pop() {
            self.overflow_pages.extend(self.other_pages.remove(&page));
            let newer = log.filter(|_| seen_in_log.insert(page)).map_or(Ok(None), |log| log.read(page))?;
            self.overflow_pages.extend(newer.map(|bytes| be32(&bytes, 0)));
        }
        Ok(())
    }

    /// Returns whether the main file has the same contents as the write-ahead log in all pages of the log, except for
    /// pages that may be malformed. After a checkpoint, the log file keeps its contents until the next commit, but
    /// SQLite reads the main file.
    fn is_checkpointed(&self, log: &LogPages) -> io::Result<bool> {
        // The main file may be truncated. Pages beyond its end cannot be compared.
        let is_comparable =
            |number: &u32| !self.other_pages.contains_key(number) && self.file.contains(*number);
        for number in log.numbers().filter(is_comparable) {
            if log.read(number)? != Some(self.file.read(number, 1)?) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Returns the free pages as SQLite sees them, with the newer versions of pages in the write-ahead log.
    fn free_pages_with_log(&self, log: Option<&LogPages>) -> io::Result<Option<Vec<u32>>> {
        log.map_or(Ok(None), |log| self.file.free_pages(|number| log.read(number)))
    }
}
