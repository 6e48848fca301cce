//! The readable rows of one b-tree in the order of their keys.

use std::collections::HashSet;

use crate::integrity::pages::{BtreePage, Cell, PageFile};

/// Result of one step of a walk.
#[derive(Debug)]
pub(super) enum Item {
    /// A row: its row id, if the table has row ids, and its record.
    Row(Option<i64>, Vec<u8>),
    /// An unreadable page with its subtree, or an unreadable part of a page.
    Unreadable,
}

/// A walk over a b-tree.
pub(super) struct Walk<'a> {
    file: &'a PageFile,
    /// `true` for a table with row ids; `false` for a table without row ids.
    has_rowids: bool,
    /// Pages visited so far. A damaged page may refer to any page, so a walk without this set might not end.
    visited: HashSet<u32>,
    stack: Vec<Level>,
    /// `true` if the root is unreadable and the walk has not returned an item for it yet.
    must_report_root: bool,
}

/// A page on the path from the root to the current page.
struct Level {
    page: BtreePage,
    /// On a leaf: index of the next cell. On an interior page: twice the index of the next cell, plus one if the cell's
    /// child was visited.
    step: usize,
}

impl<'a> Walk<'a> {
    /// Starts a walk over a table with row ids at the table's root page.
    pub(super) fn over_rowid_table(file: &'a PageFile, root: u32) -> Self {
        Self::start(file, root, true)
    }

    /// Starts a walk over a table, with or without row ids, at the table's root page.
    pub(super) fn start(file: &'a PageFile, root: u32, has_rowids: bool) -> Self {
        let mut walk =
            Self { file, has_rowids, visited: HashSet::new(), stack: Vec::new(), must_report_root: false };
        walk.must_report_root = !walk.descend(root);
        walk
    }

    /// Continues the walk with a page. Returns `false` if the page cannot be read, is of the wrong kind, or was visited
    /// before.
    fn descend(&mut self, number: u32) -> bool {
        if !self.visited.insert(number) {
            return false;
        }
        // An unreadable sector of the disk is treated like other damage.
        let page = self.file.read_btree_page(number).ok().flatten();
        match page.filter(|page| page.kind.is_table() == self.has_rowids) {
            Some(page) => {
                self.stack.push(Level { page, step: 0 });
                true
            }
            None => false,
        }
    }

    fn row(&self, cell: &Cell<'_>) -> Item {
        match self.file.record(cell) {
            Ok(Some(record)) => Item::Row(cell.rowid, record),
            Ok(None) | Err(_) => Item::Unreadable,
        }
    }
}

impl Iterator for Walk<'_> {
    type Item = Item;

    fn next(&mut self) -> Option<Item> {
        if std::mem::take(&mut self.must_report_root) {
            return Some(Item::Unreadable);
        }
        loop {
            let mut level = self.stack.pop()?;
            let step = level.step;
            level.step += 1;
            if !level.page.kind.is_interior() {
                if step >= level.page.cell_count {
                    continue;
                }
                let item = level.page.cell(step).map_or(Item::Unreadable, |cell| self.row(&cell));
                self.stack.push(level);
                return Some(item);
            }
            let (index, after_child) = (step / 2, step % 2 == 1);
            if after_child {
                // In a table with row ids, the cells of interior pages hold keys only. In other tables, they are rows.
                let item = level.page.cell(index).filter(|_| !self.has_rowids).map(|cell| self.row(&cell));
                self.stack.push(level);
                if item.is_some() {
                    return item;
                }
                continue;
            }
            let child = match index.cmp(&level.page.cell_count) {
                std::cmp::Ordering::Less => level.page.cell(index).and_then(|cell| cell.child),
                std::cmp::Ordering::Equal => level.page.right_child,
                std::cmp::Ordering::Greater => continue,
            };
            self.stack.push(level);
            if !child.is_some_and(|child| self.descend(child)) {
                return Some(Item::Unreadable);
            }
        }
    }
}
