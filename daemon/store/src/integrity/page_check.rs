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
/// A page of a b-tree is well-formed if its header, its cell pointers and the headers of all of its records are. Pages with the
/// rest of long records, and free pages, may hold any bytes; they are recognised by what refers to them.
#[derive(Debug)]
pub(crate) struct PageCheck {
    file: PageFile,
    log: PathBuf,
    next: u32,
    /// Pages that are no b-tree pages, with the number in their first bytes.
    others: HashMap<u32, u32>,
    /// Pages on which records continue.
    overflows: Vec<u32>,
}

impl PageCheck {
    /// Starts a pass with the open file and the path of its log; `None` if the file has no header of a database.
    ///
    /// # Errors
    /// When a file cannot be read; the same for the other functions.
    pub(crate) fn start(database: Arc<File>, log: PathBuf) -> io::Result<Option<Self>> {
        Ok(PageFile::from_file(database)?.map(|file| Self {
            file,
            log,
            next: 1,
            others: HashMap::new(),
            overflows: Vec::new(),
        }))
    }

    /// Makes a whole pass over a file that no connection of this process has open ([`PageFile::open`]). Returns the numbers of
    /// malformed pages.
    pub(crate) fn find_malformed(database: &Path) -> io::Result<Vec<u32>> {
        let file = Arc::new(File::open(database)?);
        let Some(mut check) = Self::start(file, log_path(database))? else { return Ok(vec![1]) };
        while check.step(1 << 20)? {}
        check.finish()
    }

    /// Examines the next pages, about `bytes` bytes. Returns whether more remain.
    pub(crate) fn step(&mut self, bytes: u64) -> io::Result<bool> {
        let first = self.next;
        let count = (bytes / self.file.page_bytes as u64).max(1);
        let read = self.file.read(first, u32::try_from(count).unwrap_or(u32::MAX))?;
        for (number, page) in (first..).zip(read.chunks_exact(self.file.page_bytes)) {
            self.next = number + 1;
            match self.file.well_formed_page(number, page.to_vec(), self.file.pages) {
                Some(page) => self.overflows.extend(page.overflows()),
                None if self.file.is_lock_page(number) => {}
                None => {
                    self.others.insert(number, be32(page, 0));
                }
            }
        }
        Ok(self.next <= self.file.pages)
    }

    /// Returns the malformed pages that are in use.
    ///
    /// While an aggregator stores, the main file is not the database of one moment: a checkpoint may be in progress. So pages to
    /// which the log refers are in use as well, and a page counts only if it is malformed when it is read again. Pages that were
    /// moved during the pass may still be among the result; another pass does not find them.
    pub(crate) fn finish(mut self) -> io::Result<Vec<u32>> {
        let missing = self.file.first_missing()?;
        self.follow_overflows(None)?;
        if self.others.is_empty() && missing.is_none() {
            return Ok(Vec::new());
        }
        let log = LogPages::open(&self.log, self.file.page_bytes)?;
        // The file may have grown, and the log has pages that are still to be appended to it.
        self.file.update_length()?;
        let last = log.iter().flat_map(LogPages::numbers).max().unwrap_or(0).max(self.file.pages);
        for number in log.iter().flat_map(LogPages::numbers) {
            let page = log.as_ref().map_or(Ok(None), |log| log.read(number))?;
            let page = page.and_then(|page| self.file.well_formed_page(number, page, last));
            self.overflows.extend(page.iter().flat_map(|page| page.overflows()));
        }
        for number in Vec::from_iter(self.others.keys().copied().filter(|number| self.file.contains(*number)))
        {
            let page = self.file.read(number, 1)?;
            if let Some(page) = self.file.well_formed_page(number, page, last) {
                self.others.remove(&number);
                self.overflows.extend(page.overflows());
            }
        }
        self.follow_overflows(log.as_ref())?;
        for free in [self.file.free_pages(|_| Ok(None))?, self.free_pages_of(log.as_ref())?] {
            for number in free.into_iter().flatten() {
                self.others.remove(&number);
            }
        }
        let mut malformed: Vec<u32> = self.others.keys().copied().chain(missing).collect();
        if let Some(log) = &log
            && malformed.iter().any(|number| log.contains(*number))
            && !self.is_checkpointed(log)?
        {
            // SQLite reads these from the log. In the main file there may be an older version, a sparse range, or nothing yet.
            malformed.retain(|number| !log.contains(*number));
        }
        malformed.sort_unstable();
        Ok(malformed)
    }

    /// Removes the pages with the rest of long records from the pages that may be malformed. A broken chain ends at a page that is
    /// malformed or missing, which is not reported here.
    fn follow_overflows(&mut self, log: Option<&LogPages>) -> io::Result<()> {
        let mut seen_in_log = HashSet::new();
        while let Some(page) = self.overflows.pop() {
            self.overflows.extend(self.others.remove(&page));
            let in_log = log.filter(|_| seen_in_log.insert(page)).map_or(Ok(None), |log| log.read(page))?;
            self.overflows.extend(in_log.map(|bytes| be32(&bytes, 0)));
        }
        Ok(())
    }

    /// Returns whether the main file has all pages of the log, except for pages that may be malformed. A log that was
    /// checkpointed stays until the next commit, and readers no longer use it.
    fn is_checkpointed(&self, log: &LogPages) -> io::Result<bool> {
        // A truncated file has no page beyond its end.
        let is_whole = |number: &u32| !self.others.contains_key(number) && self.file.contains(*number);
        for number in log.numbers().filter(is_whole) {
            if log.read(number)? != Some(self.file.read(number, 1)?) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Returns the free pages according to the log.
    fn free_pages_of(&self, log: Option<&LogPages>) -> io::Result<Option<Vec<u32>>> {
        log.map_or(Ok(None), |log| self.file.free_pages(|number| log.read(number)))
    }
}
