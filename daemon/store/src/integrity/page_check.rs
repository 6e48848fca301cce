//! One look at every page of a database's main file: which of them are malformed.

use std::collections::{HashMap, HashSet};
use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::Arc;

use super::pages::{PageFile, be32};

/// A pass over the file, some pages at a time.
///
/// A page of a b-tree is well-formed when its header, its cell pointers and the headers of all of its records are. Pages
/// that hold the rest of long records, and free ones, may hold anything, and are known by what refers to them.
#[derive(Debug)]
pub(crate) struct PageCheck {
    file: PageFile,
    next: u32,
    /// Pages that are none of a b-tree, with the number in their first bytes.
    others: HashMap<u32, u32>,
    /// Where records go on.
    overflows: Vec<u32>,
}

impl PageCheck {
    /// Begins; `None` when the file's header is not that of a database.
    ///
    /// # Errors
    /// When the file cannot be read; so for the other functions.
    pub(crate) fn begin(database: Arc<File>) -> io::Result<Option<Self>> {
        Ok(PageFile::of(database)?.map(|file| Self {
            file,
            next: 1,
            others: HashMap::new(),
            overflows: Vec::new(),
        }))
    }

    /// The whole pass at once, over a file that no connection of this process has open ([`PageFile::open`]): numbers of
    /// malformed pages.
    pub(crate) fn of(database: &Path) -> io::Result<Vec<u32>> {
        let Some(mut check) = Self::begin(Arc::new(File::open(database)?))? else { return Ok(vec![1]) };
        while check.step(1 << 20)? {}
        check.finish()
    }

    /// Looks at the next pages, about so many bytes; whether there are more.
    pub(crate) fn step(&mut self, bytes: u64) -> io::Result<bool> {
        let first = self.next;
        let count = (bytes / self.file.page_bytes as u64).max(1);
        let read = self.file.read(first, u32::try_from(count).unwrap_or(u32::MAX))?;
        for (number, page) in (first..).zip(read.chunks_exact(self.file.page_bytes)) {
            self.next = number + 1;
            match self.file.well_formed_page(number, page.to_vec()) {
                Some(page) => self.overflows.extend(page.overflows()),
                None if self.file.is_lock_page(number) => {}
                None => {
                    self.others.insert(number, be32(page, 0));
                }
            }
        }
        Ok(self.next <= self.file.pages)
    }

    /// The pages that are malformed and in use. While an aggregator stores, the file is not of one moment: only what is
    /// malformed when it is read again counts, and whether SQLite reads the page at all is for the caller to find out.
    pub(crate) fn finish(mut self) -> io::Result<Vec<u32>> {
        let missing = self.file.first_missing()?;
        if self.others.is_empty() {
            return Ok(Vec::from_iter(missing));
        }
        for first in std::mem::take(&mut self.overflows) {
            let mut page = first;
            // A chain that is broken ends at a page that is malformed or none: that is not told here.
            while let Some(next) = self.others.remove(&page) {
                page = next;
            }
        }
        let free: HashSet<u32> = self.file.free_pages()?.unwrap_or_default().into_iter().collect();
        let mut malformed = Vec::from_iter(missing);
        for number in self.others.into_keys().filter(|number| !free.contains(number)) {
            let page = self.file.read(number, 1)?;
            if self.file.well_formed_page(number, page).is_none() {
                malformed.push(number);
            }
        }
        malformed.sort_unstable();
        Ok(malformed)
    }
}
