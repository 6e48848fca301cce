//! Damage of the database's file: the check that finds damage, and the record of damage. While the record exists,
//! nothing is stored.
//!
//! The check reads the main file with `pread` through the descriptor that holds the lock: closing another descriptor
//! would release SQLite's locks in this process. The check reads page by page at a limited rate and parses the pages as
//! SQLite's file format describes them. SQLite's own `quick_check` of a table is one read transaction. For a large
//! table, this transaction would prevent checkpoints of the write-ahead log for a long time. `quick_check` also goes
//! through a cache and costs several times as much. Checksums of pages would also find a changed value, but SQLite's
//! `cksumvfs` is not in the bundled library. Checksums in a separate file would have to be written with every
//! checkpoint, which needs a virtual file system of our own.

pub(crate) mod log_pages;
mod page_check;
pub(crate) mod pages;
mod task;
#[cfg(test)]
mod tests;

use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, Weak};

use tokio::sync::watch;

use crate::database_error::DatabaseError;

pub(crate) use self::log_pages::log_path;
pub(crate) use self::page_check::PageCheck;
pub(crate) use self::task::{IntegrityCheck, find_damage_with_sqlite};

use self::pages::PageFile;

/// Record of the damage of one database, shared by all code that reads or writes the database.
///
/// The record is also written to a file beside the database, `<database>-damaged`: the damaged page may be read rarely,
/// and after a restart it may take long to find the damage again. An aggregator that finds this file stores nothing
/// until the whole database was checked.
#[derive(Clone, Debug)]
pub struct Integrity {
    database: Arc<Path>,
    damage: watch::Sender<Option<Damage>>,
    /// The database's file while this process has it open. A second descriptor would release SQLite's locks when it is
    /// closed.
    file: Arc<Mutex<Weak<File>>>,
}

/// Damage of a database.
#[derive(Clone, Debug)]
struct Damage {
    description: String,
    /// `true` if rows can be found in the file.
    is_repairable: bool,
}

impl Integrity {
    /// Creates a record without damage.
    pub fn new(database: &Path) -> Self {
        Self { database: database.into(), damage: watch::Sender::new(None), file: Arc::default() }
    }

    /// Reads the recorded damage of the file that is now at the path.
    pub(crate) fn load_record(&self) -> io::Result<()> {
        let recorded_damage = recorded_damage(&self.database)?;
        // `attach_file` sets `is_repairable` according to the contents of the file.
        self.damage
            .send_replace(recorded_damage.map(|description| Damage { description, is_repairable: true }));
        Ok(())
    }

    /// Takes the opened file, whose contents show whether a repair is possible.
    pub(crate) fn attach_file(&self, file: &Arc<File>) {
        *self.file.lock().unwrap_or_else(PoisonError::into_inner) = Arc::downgrade(file);
        let is_repairable = self.is_repairable();
        self.damage.send_if_modified(|damage| {
            damage.as_mut().is_some_and(|damage| {
                std::mem::replace(&mut damage.is_repairable, is_repairable) != is_repairable
            })
        });
    }

    /// Returns whether rows can be found in the file. Returns `true` while no file is open; when a file is opened,
    /// `attach_file` corrects the recorded value.
    fn is_repairable(&self) -> bool {
        let file = self.file.lock().unwrap_or_else(PoisonError::into_inner).upgrade();
        file.is_none_or(has_table_list)
    }

    /// Returns what is damaged; `None` while there is no damage.
    pub fn damage(&self) -> Option<String> {
        self.damage.borrow().as_ref().map(|damage| damage.description.clone())
    }

    /// Waits until damage is found.
    async fn wait_for_damage(&self) {
        let mut damage = self.damage.subscribe();
        // The sender lives as long as `self`.
        let _never_closed = damage.wait_for(Option::is_some).await;
    }

    /// Returns a sentence for people: which database is damaged, what is damaged, and what to do. `None` while there is
    /// no damage.
    pub fn damage_message(&self) -> Option<String> {
        let damage = self.damage.borrow();
        let database = self.database.display();
        damage.as_ref().map(|Damage { description, is_repairable }| {
            format!(
                "the database {database} is damaged: {description}; {}",
                remedy(&self.database, *is_repairable)
            )
        })
    }

    /// Records damage, unless damage is recorded already: the first damage found is the closest to the cause.
    pub(crate) fn record_damage(&self, description: impl Into<String>) {
        let description = description.into();
        let is_repairable = self.is_repairable();
        let is_first = self.damage.send_if_modified(|damage| {
            let is_first = damage.is_none();
            damage.get_or_insert_with(|| Damage { description: description.clone(), is_repairable });
            is_first
        });
        if !is_first {
            return;
        }
        tracing::error!(
            "the database {database} is damaged: {description}; nothing is stored any more, and agents keep their events; {remedy}",
            database = self.database.display(),
            remedy = remedy(&self.database, is_repairable)
        );
        if let Err(error) = fs::write(record_path(&self.database), format!("{description}\n")) {
            tracing::warn!(
                %error, file = %record_path(&self.database).display(),
                "cannot record the damage of the database in a file; after a restart the check has to find the damage again"
            );
        }
    }

    /// Records damage if the error reports damage.
    pub fn record_if_damage(&self, error: &DatabaseError) {
        if error.is_damage() {
            self.record_damage(error.to_string());
        }
    }

    /// Removes the record after a check of the whole database found no damage.
    fn clear(&self) -> io::Result<()> {
        delete_record(&self.database)?;
        self.damage.send_replace(None);
        Ok(())
    }
}

/// Returns what to do about a damaged database. If its list of tables is lost, no row can be found, and a repair has
/// nothing to salvage.
pub(crate) fn remedy(database: &Path, is_repairable: bool) -> String {
    if is_repairable {
        format!("stop the aggregator and run `peernetd doctor --repair --database {}`", database.display())
    } else {
        "its list of tables is lost, so that no row can be found: stop the aggregator and replace the database by the newest \
         backup; agents then send the events in their spools again"
            .to_owned()
    }
}

/// Returns whether the file has a valid header and a valid first page of the list of tables.
pub(crate) fn has_table_list(file: Arc<File>) -> bool {
    let first_page =
        PageFile::from_file(file).and_then(|file| file.map_or(Ok(None), |file| file.read_btree_page(1)));
    matches!(first_page, Ok(Some(page)) if page.kind.is_table())
}

/// Returns the path of the file that records damage. A symbolic link is resolved, because the file lies beside the
/// database itself.
fn record_path(database: &Path) -> PathBuf {
    let mut path = fs::canonicalize(database).unwrap_or_else(|_| database.to_owned()).into_os_string();
    path.push("-damaged");
    path.into()
}

/// Returns the damage that an aggregator found earlier.
///
/// # Errors
/// When the file that records the damage cannot be read.
pub(crate) fn recorded_damage(database: &Path) -> io::Result<Option<String>> {
    match fs::read_to_string(record_path(database)) {
        Ok(text) => Ok(Some(text.trim().to_owned())),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// Removes the record of damage that was found earlier.
pub(crate) fn delete_record(database: &Path) -> io::Result<()> {
    remove_if_exists(&record_path(database))
}

/// Removes a file that may be missing.
pub(crate) fn remove_if_exists(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}
