//! The part of SQLite's file format that is needed to find damage and to read rows without SQLite:
//! <https://www.sqlite.org/fileformat2.html>.

use std::fs::File;
use std::io::{self, ErrorKind};
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::Arc;

/// The first bytes of every SQLite file.
const MAGIC: &[u8; 16] = b"SQLite format 3\0";
/// Size of the file's header, at the start of page 1.
const HEADER_BYTES: usize = 100;
/// Offset of the bytes that SQLite locks. The page that holds them is never used.
const LOCK_BYTE: u64 = 1 << 30;

/// A database's main file, read page by page without SQLite: without locks, transactions, or caches other than the kernel's.
#[derive(Debug)]
pub(crate) struct PageFile {
    file: Arc<File>,
    /// Size of a page in bytes.
    pub(crate) page_bytes: usize,
    /// Number of bytes of a page that hold content.
    usable: usize,
    /// Number of complete pages in the file.
    pub(crate) pages: u32,
}

/// Kind of a b-tree page; the file format defines the numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PageKind {
    IndexInterior = 2,
    TableInterior = 5,
    IndexLeaf = 10,
    TableLeaf = 13,
}

/// A page of a b-tree whose header and cell pointers are well-formed.
#[derive(Debug)]
pub(crate) struct BtreePage {
    bytes: Vec<u8>,
    usable: usize,
    pub(crate) kind: PageKind,
    /// Offset of the array of cell pointers.
    pointers: usize,
    pub(crate) cells: usize,
    /// Last child of an interior page.
    pub(crate) right_child: Option<u32>,
}

/// An entry of a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Cell<'a> {
    /// Child before the entry, on an interior page.
    pub(crate) child: Option<u32>,
    /// Key in a table with row ids.
    pub(crate) rowid: Option<i64>,
    /// Part of the record that is on this page; empty on the interior pages of a table with row ids.
    pub(crate) local: &'a [u8],
    /// Size of the whole record in bytes.
    pub(crate) record_bytes: usize,
    /// First page with the rest of the record.
    pub(crate) overflow: Option<u32>,
}

impl PageFile {
    /// Opens a file that no connection of this process has open: when the descriptor is closed, the system releases all locks
    /// that SQLite holds on the file in this process.
    ///
    /// # Errors
    /// If it cannot be read; the same for the other functions.
    pub(crate) fn open(path: &Path) -> io::Result<Option<Self>> {
        Self::from_file(Arc::new(File::open(path)?))
    }

    /// Makes it of an open file; `None` if the file has no header of a database.
    pub(crate) fn from_file(file: Arc<File>) -> io::Result<Option<Self>> {
        let mut header = [0; HEADER_BYTES];
        match file.read_exact_at(&mut header, 0) {
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(None),
            read => read?,
        }
        let page_bytes = match u16::from_be_bytes([header[16], header[17]]) {
            1 => 65_536,
            bytes => usize::from(bytes),
        };
        let usable = page_bytes.saturating_sub(usize::from(header[20]));
        if header[..16] != *MAGIC || !page_bytes.is_power_of_two() || page_bytes < 512 || usable < 480 {
            return Ok(None);
        }
        let mut file = Self { file, page_bytes, usable, pages: 0 };
        file.update_length()?;
        Ok(Some(file))
    }

    /// Reads the length of the file again, because it may have grown.
    pub(crate) fn update_length(&mut self) -> io::Result<()> {
        let pages = self.file.metadata()?.len() / self.page_bytes as u64;
        self.pages = u32::try_from(pages).unwrap_or(u32::MAX);
        Ok(())
    }

    /// Reads at most `count` pages from `first`; the file's first page is 1.
    pub(crate) fn read(&self, first: u32, count: u32) -> io::Result<Vec<u8>> {
        let count = count.min((self.pages + 1).saturating_sub(first)) as usize;
        let mut bytes = vec![0; count * self.page_bytes];
        self.file.read_exact_at(&mut bytes, u64::from(first - 1) * self.page_bytes as u64)?;
        Ok(bytes)
    }

    /// Returns the first page that the header counts and that is missing, because the file is truncated; `None` if it is not.
    pub(crate) fn first_missing(&self) -> io::Result<Option<u32>> {
        let counted = be32(&self.read(1, 1)?, 28);
        let pages = u32::try_from(self.file.metadata()?.len() / self.page_bytes as u64).unwrap_or(u32::MAX);
        Ok((counted > pages).then(|| pages + 1))
    }

    /// Returns whether the file has a page of this number.
    pub(crate) const fn contains(&self, page: u32) -> bool {
        page >= 1 && page <= self.pages
    }

    /// Returns whether SQLite never uses that page.
    pub(crate) const fn is_lock_page(&self, page: u32) -> bool {
        page as u64 == LOCK_BYTE / self.page_bytes as u64 + 1
    }

    /// Parses a page as part of a b-tree; `None` if its header or a cell pointer is malformed.
    pub(crate) fn btree_page(&self, number: u32, bytes: Vec<u8>) -> Option<BtreePage> {
        BtreePage::parse(number, bytes, self.usable)
    }

    /// Parses a page; `None` unless all of its entries are well-formed, too, and refer to pages up to the number `last`.
    pub(crate) fn well_formed_page(&self, number: u32, bytes: Vec<u8>, last: u32) -> Option<BtreePage> {
        let page = self.btree_page(number, bytes)?;
        let exists = |page: Option<u32>| page.is_none_or(|page| (1..=last).contains(&page));
        let fits = |cell: Cell<'_>| exists(cell.child) && exists(cell.overflow);
        let whole =
            exists(page.right_child) && (0..page.cells).all(|index| page.cell(index).is_some_and(fits));
        whole.then_some(page)
    }

    /// Reads one page of a b-tree; `None` if the page is of another kind.
    pub(crate) fn read_btree_page(&self, number: u32) -> io::Result<Option<BtreePage>> {
        if !self.contains(number) {
            return Ok(None);
        }
        Ok(self.btree_page(number, self.read(number, 1)?))
    }

    /// Reads the whole record of a cell; `None` if the chain of pages with its rest is broken.
    pub(crate) fn record(&self, cell: &Cell<'_>) -> io::Result<Option<Vec<u8>>> {
        let mut record = cell.local.to_vec();
        let mut next = cell.overflow;
        while record.len() < cell.record_bytes {
            let Some(page) = next.filter(|page| self.contains(*page)) else { return Ok(None) };
            let bytes = self.read(page, 1)?;
            let part = (cell.record_bytes - record.len()).min(self.usable - 4);
            record.extend_from_slice(&bytes[4..4 + part]);
            next = Some(be32(&bytes, 0)).filter(|page| *page != 0);
        }
        Ok(next.is_none().then_some(record))
    }

    /// Returns all free pages, or `None` if the list of them is broken. `newer` returns the newer version of a page, if there is
    /// one.
    pub(crate) fn free_pages(
        &self,
        newer: impl Fn(u32) -> io::Result<Option<Vec<u8>>>,
    ) -> io::Result<Option<Vec<u32>>> {
        let read = |number| match newer(number)? {
            Some(bytes) => Ok(Some(bytes)),
            None if self.contains(number) => self.read(number, 1).map(Some),
            None => io::Result::Ok(None),
        };
        let Some(first) = read(1)? else { return Ok(None) };
        let (mut trunk, expected) = (be32(&first, 32), be32(&first, 36) as usize);
        let mut free = Vec::new();
        while trunk != 0 {
            if free.len() >= expected {
                return Ok(None);
            }
            let Some(bytes) = read(trunk)? else { return Ok(None) };
            free.push(trunk);
            let leaves = be32(&bytes, 4) as usize;
            if leaves > self.usable / 4 - 2 {
                return Ok(None);
            }
            free.extend((0..leaves).map(|leaf| be32(&bytes, 8 + 4 * leaf)));
            trunk = be32(&bytes, 0);
        }
        Ok((free.len() == expected).then_some(free))
    }
}

impl BtreePage {
    fn parse(number: u32, bytes: Vec<u8>, usable: usize) -> Option<Self> {
        let start = if number == 1 { HEADER_BYTES } else { 0 };
        let kind = match bytes[start] {
            2 => PageKind::IndexInterior,
            5 => PageKind::TableInterior,
            10 => PageKind::IndexLeaf,
            13 => PageKind::TableLeaf,
            _ => return None,
        };
        let cells = usize::from(be16(&bytes, start + 3));
        let content = match be16(&bytes, start + 5) {
            0 => 65_536,
            offset => usize::from(offset),
        };
        let pointers = start + if kind.is_interior() { 12 } else { 8 };
        let first_free = pointers + 2 * cells;
        if first_free > content || content > usable || bytes[start + 7] > 60 {
            return None;
        }
        let right_child = kind.is_interior().then(|| be32(&bytes, start + 8));
        let page = Self { bytes, usable, kind, pointers, cells, right_child };
        // Every cell takes at least four bytes between the start of the content and the end of the page.
        let fits = |index| (content..=usable - 4).contains(&page.pointer(index));
        (0..cells).all(fits).then_some(page)
    }

    fn pointer(&self, index: usize) -> usize {
        usize::from(be16(&self.bytes, self.pointers + 2 * index))
    }

    /// Returns an entry, or `None` if it is malformed.
    pub(crate) fn cell(&self, index: usize) -> Option<Cell<'_>> {
        let mut rest = self.bytes.get(self.pointer(index)..self.usable)?;
        let child = if self.kind.is_interior() {
            let (child, after) = rest.split_at_checked(4)?;
            rest = after;
            Some(be32(child, 0))
        } else {
            None
        };
        if self.kind == PageKind::TableInterior {
            let (rowid, _) = varint(rest)?;
            return Some(Cell { child, rowid: Some(rowid), local: &[], record_bytes: 0, overflow: None });
        }
        let (length, after) = varint(rest)?;
        rest = after;
        let record_bytes = usize::try_from(length).ok()?;
        let rowid = if self.kind == PageKind::TableLeaf {
            let (rowid, after) = varint(rest)?;
            rest = after;
            Some(rowid)
        } else {
            None
        };
        let local_bytes = self.local_bytes(record_bytes);
        let (local, after) = rest.split_at_checked(local_bytes)?;
        let overflow = if local_bytes < record_bytes { Some(be32(after.get(..4)?, 0)) } else { None };
        let cell = Cell { child, rowid, local, record_bytes, overflow };
        cell.is_record().then_some(cell)
    }

    /// Returns how many bytes of a record of that length are on the page itself.
    fn local_bytes(&self, record_bytes: usize) -> usize {
        let usable = self.usable;
        let max_local =
            if self.kind == PageKind::TableLeaf { usable - 35 } else { (usable - 12) * 64 / 255 - 23 };
        if record_bytes <= max_local {
            return record_bytes;
        }
        let min_local = (usable - 12) * 32 / 255 - 23;
        let local = min_local + (record_bytes - min_local) % (usable - 4);
        if local <= max_local { local } else { min_local }
    }

    /// Returns the first pages of the records that continue on other pages.
    pub(crate) fn overflows(&self) -> impl Iterator<Item = u32> {
        (0..self.cells).filter_map(|index| self.cell(index)?.overflow)
    }
}

impl PageKind {
    /// Returns whether it has children.
    pub(crate) const fn is_interior(self) -> bool {
        matches!(self, Self::IndexInterior | Self::TableInterior)
    }

    /// Returns whether it belongs to a table with row ids, and not to an index or a table without them.
    pub(crate) const fn is_table(self) -> bool {
        matches!(self, Self::TableInterior | Self::TableLeaf)
    }
}

impl Cell<'_> {
    /// Returns whether the columns that the record's header declares take exactly as many bytes as the record has. A header that
    /// continues on another page is not examined.
    fn is_record(&self) -> bool {
        let Some((header, mut types)) = varint(self.local) else { return false };
        let Ok(header) = usize::try_from(header) else { return false };
        let before = self.local.len() - types.len();
        if header < before || header > self.record_bytes {
            return false;
        }
        if header > self.local.len() {
            return true;
        }
        types = &self.local[before..header];
        let mut bytes = header;
        while !types.is_empty() {
            let Some((code, after)) = varint(types) else { return false };
            let Some(length) = column_bytes(code) else { return false };
            let Some(sum) = bytes.checked_add(length) else { return false };
            (bytes, types) = (sum, after);
        }
        bytes == self.record_bytes
    }
}

/// Returns the size of a column of that type; `None` for a type that does not exist.
pub(crate) fn column_bytes(code: i64) -> Option<usize> {
    Some(match code {
        0 | 8 | 9 => 0,
        1..=4 => usize::try_from(code).ok()?,
        5 => 6,
        6 | 7 => 8,
        12.. => usize::try_from((code - 12) / 2).ok()?,
        _ => return None,
    })
}

/// Reads a number of variable length. Returns it with the bytes after it.
pub(crate) fn varint(bytes: &[u8]) -> Option<(i64, &[u8])> {
    let mut value = 0_i64;
    for (at, byte) in bytes.iter().take(9).enumerate() {
        if at == 8 {
            return Some((value << 8 | i64::from(*byte), &bytes[9..]));
        }
        value = value << 7 | i64::from(byte & 0x7f);
        if byte & 0x80 == 0 {
            return Some((value, &bytes[at + 1..]));
        }
    }
    None
}

fn be16(bytes: &[u8], at: usize) -> u16 {
    u16::from_be_bytes([bytes[at], bytes[at + 1]])
}

pub(crate) fn be32(bytes: &[u8], at: usize) -> u32 {
    u32::from_be_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}
