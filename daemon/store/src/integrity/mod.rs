//! Whether the database's file is damaged: who finds it says so here, and nothing is stored into it from then on.

mod page_check;
pub(crate) mod pages;
mod task;
#[cfg(test)]
mod tests;

use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio::sync::watch;

use crate::database_error::DatabaseError;

pub(crate) use self::page_check::PageCheck;
pub(crate) use self::task::{IntegrityCheck, sqlite_finds};

/// What is known of the damage of one database, shared by all who read or write it.
///
/// It is remembered in a file beside the database, `<database>-damaged`, because the page that is damaged may be one that
/// nobody reads for long: an aggregator that finds the file stores nothing until the whole database was checked.
#[derive(Clone, Debug)]
pub struct Integrity {
    database: Arc<Path>,
    damage: watch::Sender<Option<String>>,
}

impl Integrity {
    /// Of that database.
    pub fn of(database: &Path) -> Self {
        Self { database: database.into(), damage: watch::Sender::new(None) }
    }

    /// Takes up what is remembered of the file that stands there now.
    pub(crate) fn recall(&self) -> io::Result<()> {
        self.damage.send_replace(remembered(&self.database)?);
        Ok(())
    }

    /// What is damaged, if anything is.
    pub fn damage(&self) -> Option<String> {
        self.damage.borrow().clone()
    }

    /// Waits until damage is found.
    async fn damaged(&self) {
        let mut damage = self.damage.subscribe();
        // The sender lives as long as `self`.
        let _never_closed = damage.wait_for(Option::is_some).await;
    }

    /// Why nothing is stored, and what to do; `None` while nothing is damaged.
    pub fn refusal(&self) -> Option<String> {
        let damage = self.damage.borrow();
        let database = self.database.display();
        damage.as_ref().map(|damage| {
            format!(
                "the database {database} is damaged: {damage}; stop the aggregator and run \
                 `peernetd doctor --repair --database {database}`"
            )
        })
    }

    /// Takes down damage. What was found first stays.
    pub(crate) fn found(&self, what: impl Into<String>) {
        let what = what.into();
        let first = self.damage.send_if_modified(|known| {
            let first = known.is_none();
            known.get_or_insert_with(|| what.clone());
            first
        });
        if !first {
            return;
        }
        tracing::error!(
            "the database {database} is damaged: {what}; nothing more is stored, agents keep their events; stop the \
             aggregator and run `peernetd doctor --repair --database {database}`",
            database = self.database.display()
        );
        if let Err(error) = fs::write(marker(&self.database), format!("{what}\n")) {
            tracing::warn!(
                %error, file = %marker(&self.database).display(),
                "cannot remember that the database is damaged; the check finds it again after a restart"
            );
        }
    }

    /// Takes down damage if that is what the error tells of.
    pub fn note(&self, error: &DatabaseError) {
        if error.is_damage() {
            self.found(error.to_string());
        }
    }

    /// The whole database was checked, and is not damaged.
    fn cleared(&self) -> io::Result<()> {
        forget(&self.database)?;
        self.damage.send_replace(None);
        Ok(())
    }
}

/// The file that remembers damage: beside the database itself, also when that is named by a link.
fn marker(database: &Path) -> PathBuf {
    let mut path = fs::canonicalize(database).unwrap_or_else(|_| database.to_owned()).into_os_string();
    path.push("-damaged");
    path.into()
}

/// The damage that an aggregator found earlier.
///
/// # Errors
/// When the file that says so cannot be read.
pub(crate) fn remembered(database: &Path) -> io::Result<Option<String>> {
    match fs::read_to_string(marker(database)) {
        Ok(text) => Ok(Some(text.trim().to_owned())),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// Forgets damage that was found earlier.
pub(crate) fn forget(database: &Path) -> io::Result<()> {
    match fs::remove_file(marker(database)) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}
