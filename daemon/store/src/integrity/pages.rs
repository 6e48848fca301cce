//! The part of SQLite's file format that is needed to find damage and to read rows without SQLite:
//! <https://www.sqlite.org/fileformat2.html>.

use std::collections::HashSet;
use std::fs::File;
use std::io::{self, ErrorKind};
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::Arc;

/// The first bytes of every SQLite file.
const MAGIC: &[u8; 16] = b"SQLite format 3\0";
/// Size of the file's header, at the start of page 1.
const HEADER_BYTES: usize = 100;
/// Offset of the bytes that SQLite locks. The page that contains these bytes is never used.
const LOCK_BYTE: u64 = 1 << 30;

/// A database's main file, read page by page without SQLite: without locks, transactions, or caches other than the
/// kernel's.
#[derive(Debug)]
pub(crate) struct PageFile {
    file: Arc<File>,
    /// Size of a page in bytes.
    pub(crate) page_bytes: usize,
    /// Number of bytes of a page that hold content. The rest, at the end of the page, is reserved for extensions.
    usable_bytes: usize,
    /// Number of complete pages in the file, as of the last [`Self::update_length`].
    pub(crate) page_count: u32,
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
    usable_bytes: usize,
    pub(crate) kind: PageKind,
    /// Offset of the array of cell pointers.
    pointers_offset: usize,
    /// Number of cells.
    pub(crate) cell_count: usize,
    /// Number of the last child page; `None` on a leaf page.
    pub(crate) right_child: Option<u32>,
}

/// A cell of a page: one entry of the b-tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Cell<'a> {
    /// Number of the child page that has the entries before this entry; `None` on a leaf page.
    pub(crate) child: Option<u32>,
    /// Row id, which is the key in a table with row ids; `None` in an index or a table without row ids.
    pub(crate) rowid: Option<i64>,
    /// Part of the record that is on this page; empty on the interior pages of a table with row ids.
    pub(crate) local_content: &'a [u8],
    /// Size of the whole record in bytes.
    pub(crate) record_bytes: usize,
    /// Number of the first overflow page, on which the record continues; `None` if the whole record is on this page.
    pub(crate) overflow: Option<u32>,
}

impl PageFile {
    /// Opens a file. No connection of this process may have the file open: when the descriptor is closed, the system
    /// releases all locks that SQLite holds on the file in this process.
    ///
    /// # Errors
    /// If the file cannot be read. This applies to all functions here that return an `io::Result`.
    pub(crate) fn open(path: &Path) -> io::Result<Option<Self>> {
        Self::from_file(Arc::new(File::open(path)?))
    }

    /// Creates the value from an open file; `None` if the file has no header of a database.
    pub(crate) fn from_file(file: Arc<File>) -> io::Result<Option<Self>> {
        let mut header = [0; HEADER_BYTES];
        match file.read_exact_at(&mut header, 0) {
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(None),
            read => read?,
        }
        let page_bytes = match u16::from_be_bytes([header[16], header[17]]) {
            // 65,536 does not fit into the two bytes of the field.
            1 => 65_536,
            bytes => usize::from(bytes),
        };
        let usable_bytes = page_bytes.saturating_sub(usize::from(header[20]));
        // The file format does not allow a usable size below 480 bytes.
        if header[..16] != *MAGIC || !page_bytes.is_power_of_two() || page_bytes < 512 || usable_bytes < 480 {
            return Ok(None);
        }
        let mut file = Self { file, page_bytes, usable_bytes, page_count: 0 };
        file.update_length()?;
        Ok(Some(file))
    }

    /// Reads the length of the file again, because it may have grown.
    pub(crate) fn update_length(&mut self) -> io::Result<()> {
        let pages = self.file.metadata()?.len() / self.page_bytes as u64;
        self.page_count = u32::try_from(pages).unwrap_or(u32::MAX);
        Ok(())
    }

    /// Reads at most `count` pages from `first`; the file's first page is 1.
    pub(crate) fn read(&self, first: u32, count: u32) -> io::Result<Vec<u8>> {
        // The last read of a file is usually shorter.
        let count = count.min((self.page_count + 1).saturating_sub(first)) as usize;
        let mut bytes = vec![0; count * self.page_bytes];
        self.file.read_exact_at(&mut bytes, u64::from(first - 1) * self.page_bytes as u64)?;
        Ok(bytes)
    }

    /// Returns the number of the first missing page if the file is truncated: the header states more pages than the
    /// file has.
    pub(crate) fn first_missing_page(&self) -> io::Result<Option<u32>> {
        let stated_pages = be32(&self.read(1, 1)?, 28);
        let pages = u32::try_from(self.file.metadata()?.len() / self.page_bytes as u64).unwrap_or(u32::MAX);
        Ok((stated_pages > pages).then(|| pages + 1))
    }

    /// Returns whether the file has a page of this number.
    pub(crate) const fn contains(&self, page: u32) -> bool {
        page >= 1 && page <= self.page_count
    }

    /// Returns whether the page has the bytes that SQLite locks. SQLite never uses this page.
    pub(crate) const fn is_lock_page(&self, page: u32) -> bool {
        page as u64 == LOCK_BYTE / self.page_bytes as u64 + 1
    }

    /// Parses a page as part of a b-tree; `None` if its header or a cell pointer is malformed.
    pub(crate) fn btree_page(&self, number: u32, bytes: Vec<u8>) -> Option<BtreePage> {
        BtreePage::parse(number, bytes, self.usable_bytes)
    }

    /// Parses a page as part of a b-tree; `None` if its header, a cell pointer or a cell is malformed, or if the page
    /// refers to a page after `last`, the last page of the database.
    pub(crate) fn well_formed_page(&self, number: u32, bytes: Vec<u8>, last: u32) -> Option<BtreePage> {
        let page = self.btree_page(number, bytes)?;
        let exists = |page: Option<u32>| page.is_none_or(|page| (1..=last).contains(&page));
        let refers_to_pages = |cell: Cell<'_>| exists(cell.child) && exists(cell.overflow);
        let is_well_formed = exists(page.right_child)
            && (0..page.cell_count).all(|index| page.cell(index).is_some_and(refers_to_pages));
        is_well_formed.then_some(page)
    }

    /// Reads one page of a b-tree; `None` if the file has no such page, or if the page is malformed or of another kind.
    pub(crate) fn read_btree_page(&self, number: u32) -> io::Result<Option<BtreePage>> {
        if !self.contains(number) {
            return Ok(None);
        }
        Ok(self.btree_page(number, self.read(number, 1)?))
    }

    /// Reads the whole record of a cell; `None` if its chain of overflow pages is broken.
    pub(crate) fn record(&self, cell: &Cell<'_>) -> io::Result<Option<Vec<u8>>> {
        self.record_from_pages(cell, |page| self.read(page, 1))
    }

    /// Reads a record like [`record`](Self::record); `read_page` reads an overflow page.
    pub(super) fn record_from_pages(
        &self,
        cell: &Cell<'_>,
        mut read_page: impl FnMut(u32) -> io::Result<Vec<u8>>,
    ) -> io::Result<Option<Vec<u8>>> {
        let mut record = cell.local_content.to_vec();
        let mut next = cell.overflow;
        // A damaged cell may state any length, so the length does not bound a chain that refers to itself.
        let mut visited = HashSet::new();
        while record.len() < cell.record_bytes {
            let Some(page) = next.filter(|page| self.contains(*page) && visited.insert(*page)) else {
                return Ok(None);
            };
            let bytes = read_page(page)?;
            // The first four bytes of an overflow page are the number of the next one.
            let part = (cell.record_bytes - record.len()).min(self.usable_bytes - 4);
            record.extend_from_slice(&bytes[4..4 + part]);
            next = Some(be32(&bytes, 0)).filter(|page| *page != 0);
        }
        // A chain that continues after the record belongs to another record.
        Ok(next.is_none().then_some(record))
    }

    /// Returns all free pages, or `None` if the list of free pages is broken. `read_newer` returns the version of a
    /// page in the write-ahead log, if the log has the page.
    pub(crate) fn free_pages(
        &self,
        read_newer: impl Fn(u32) -> io::Result<Option<Vec<u8>>>,
    ) -> io::Result<Option<Vec<u32>>> {
        let read = |number| match read_newer(number)? {
            Some(bytes) => Ok(Some(bytes)),
            None if self.contains(number) => self.read(number, 1).map(Some),
            None => io::Result::Ok(None),
        };
        let Some(first) = read(1)? else { return Ok(None) };
        let (mut trunk, expected) = (be32(&first, 32), be32(&first, 36) as usize);
        let mut free = Vec::new();
        let mut visited = HashSet::new();
        while trunk != 0 {
            // The stated length may be damaged, too, so it does not bound a list that refers to itself.
            if free.len() >= expected || !visited.insert(trunk) {
                return Ok(None);
            }
            let Some(bytes) = read(trunk)? else { return Ok(None) };
            free.push(trunk);
            let leaves = be32(&bytes, 4) as usize;
            // Two numbers precede the leaves: the next trunk page, and the number of leaves.
            if leaves > self.usable_bytes / 4 - 2 {
                return Ok(None);
            }
            free.extend((0..leaves).map(|leaf| be32(&bytes, 8 + 4 * leaf)));
            trunk = be32(&bytes, 0);
        }
        Ok((free.len() == expected).then_some(free))
    }
}

impl BtreePage {
    fn parse(number: u32, bytes: Vec<u8>, usable_bytes: usize) -> Option<Self> {
        let start = if number == 1 { HEADER_BYTES } else { 0 };
        let kind = match bytes[start] {
            2 => PageKind::IndexInterior,
            5 => PageKind::TableInterior,
            10 => PageKind::IndexLeaf,
            13 => PageKind::TableLeaf,
            _ => return None,
        };
        let cell_count = usize::from(be16(&bytes, start + 3));
        let content_offset = match be16(&bytes, start + 5) {
            // 65,536 does not fit into the two bytes of the field.
            0 => 65_536,
            offset => usize::from(offset),
        };
        let pointers_offset = start + if kind.is_interior() { 12 } else { 8 };
        let pointers_end = pointers_offset + 2 * cell_count;
        // The last condition: SQLite keeps the number of fragmented free bytes at 60 or less.
        if pointers_end > content_offset || content_offset > usable_bytes || bytes[start + 7] > 60 {
            return None;
        }
        let right_child = kind.is_interior().then(|| be32(&bytes, start + 8));
        let page = Self { bytes, usable_bytes, kind, pointers_offset, cell_count, right_child };
        // Every cell takes at least four bytes between the start of the content and the end of the page.
        let fits = |index| (content_offset..=usable_bytes - 4).contains(&page.pointer(index));
        (0..cell_count).all(fits).then_some(page)
    }

    /// Returns the offset of the cell with this index within the page.
    fn pointer(&self, index: usize) -> usize {
        usize::from(be16(&self.bytes, self.pointers_offset + 2 * index))
    }

    /// Returns the entry with this index, or `None` if the page has no such entry or the entry is malformed.
    pub(crate) fn cell(&self, index: usize) -> Option<Cell<'_>> {
        // The bytes after the last cell pointer are unused. SQLite does not clear them, so they may be the pointer of a
        // deleted or moved cell, whose bytes may still be on the page.
        if index >= self.cell_count {
            return None;
        }
        let mut rest = self.bytes.get(self.pointer(index)..self.usable_bytes)?;
        let child = if self.kind.is_interior() {
            let (child, after) = rest.split_at_checked(4)?;
            rest = after;
            Some(be32(child, 0))
        } else {
            None
        };
        if self.kind == PageKind::TableInterior {
            let (rowid, _) = varint(rest)?;
            // Interior pages of these tables have keys without records.
            return Some(Cell {
                child,
                rowid: Some(rowid),
                local_content: &[],
                record_bytes: 0,
                overflow: None,
            });
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
        let (local_content, after) = rest.split_at_checked(local_bytes)?;
        let overflow = if local_bytes < record_bytes { Some(be32(after.get(..4)?, 0)) } else { None };
        let cell = Cell { child, rowid, local_content, record_bytes, overflow };
        cell.is_record().then_some(cell)
    }

    /// Returns how many bytes of a record with `record_bytes` bytes are on this page; the rest is on overflow pages.
    fn local_bytes(&self, record_bytes: usize) -> usize {
        let usable = self.usable_bytes;
        // The constants are from section 1.6 of the description of the file format.
        let max_local =
            if self.kind == PageKind::TableLeaf { usable - 35 } else { (usable - 12) * 64 / 255 - 23 };
        if record_bytes <= max_local {
            return record_bytes;
        }
        let min_local = (usable - 12) * 32 / 255 - 23;
        let local = min_local + (record_bytes - min_local) % (usable - 4);
        if local <= max_local { local } else { min_local }
    }

    /// Returns the first overflow page of each record that continues on other pages.
    pub(crate) fn overflow_pages(&self) -> impl Iterator<Item = u32> {
        (0..self.cell_count).filter_map(|index| self.cell(index)?.overflow)
    }
}

impl PageKind {
    /// Returns whether pages of this kind have children.
    pub(crate) const fn is_interior(self) -> bool {
        matches!(self, Self::IndexInterior | Self::TableInterior)
    }

    /// Returns whether pages of this kind belong to a table with row ids. Otherwise they belong to an index, or to a
    /// table without row ids.
    pub(crate) const fn is_table(self) -> bool {
        matches!(self, Self::TableInterior | Self::TableLeaf)
    }
}

impl Cell<'_> {
    /// Returns whether the columns that the record's header declares take exactly as many bytes as the record has. A
    /// header that continues on another page is not examined.
    fn is_record(&self) -> bool {
        let Some((header_bytes, mut types)) = varint(self.local_content) else { return false };
        let Ok(header_bytes) = usize::try_from(header_bytes) else { return false };
        let types_offset = self.local_content.len() - types.len();
        if header_bytes < types_offset || header_bytes > self.record_bytes {
            return false;
        }
        if header_bytes > self.local_content.len() {
            return true;
        }
        types = &self.local_content[types_offset..header_bytes];
        let mut bytes = header_bytes;
        while !types.is_empty() {
            let Some((code, after)) = varint(types) else { return false };
            let Some(length) = column_bytes(code) else { return false };
            let Some(sum) = bytes.checked_add(length) else { return false };
            (bytes, types) = (sum, after);
        }
        bytes == self.record_bytes
    }
}

/// Returns the size of a column, in bytes, from the code of its type in a record's header; `None` for a code that does
/// not exist.
pub(crate) fn column_bytes(code: i64) -> Option<usize> {
    Some(match code {
        0 | 8 | 9 => 0,
        1..=4 => usize::try_from(code).ok()?,
        5 => 6,
        6 | 7 => 8,
        // The file format reserves 10 and 11.
        12.. => usize::try_from((code - 12) / 2).ok()?,
        _ => return None,
    })
}

/// Reads a number of variable length. Returns the number and the bytes after it.
pub(crate) fn varint(bytes: &[u8]) -> Option<(i64, &[u8])> {
    let mut value = 0_i64;
    for (index, byte) in bytes.iter().take(9).enumerate() {
        // The ninth byte contributes all its bits; the earlier bytes contribute seven bits each.
        if index == 8 {
            return Some((value << 8 | i64::from(*byte), &bytes[9..]));
        }
        value = value << 7 | i64::from(byte & 0x7f);
        if byte & 0x80 == 0 {
            return Some((value, &bytes[index + 1..]));
        }
    }
    None
}

/// Reads a big-endian number of 16 bits.
fn be16(bytes: &[u8], offset: usize) -> u16 {
    u16::from_be_bytes([bytes[offset], bytes[offset + 1]])
}

/// Reads a big-endian number of 32 bits.
pub(crate) fn be32(bytes: &[u8], offset: usize) -> u32 {
    u32::from_be_bytes([bytes[offset], bytes[offset + 1], bytes[offset + 2], bytes[offset + 3]])
}
