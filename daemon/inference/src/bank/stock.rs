//! Cache of the loaded models of the bank's folders, limited in number.

use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use peernet_logger::Slug;

use super::shelf::{Shelf, Stamp};
use super::{BankConfig, ModelFolders};
use crate::LoadError;

/// Models of the folders that are loaded or being loaded.
pub(super) struct Stock {
    config: BankConfig,
    folders: ModelFolders,
    /// Entries, ordered by their last request; the oldest comes first.
    shelves: Mutex<Vec<Arc<Shelf>>>,
}

impl Stock {
    pub(super) fn new(config: BankConfig) -> Self {
        let folders = ModelFolders::of(config.folders.iter().cloned());
        Self { config, folders, shelves: Mutex::default() }
    }

    /// Returns the names of the models on disk that can be requested.
    pub(super) fn names(&self) -> Vec<Slug> {
        if self.config.devices.is_empty() {
            return Vec::new();
        }
        let usable =
            self.folders.list().into_iter().filter(|found| found.hidden_by.is_none() && found.card.is_ok());
        usable.map(|found| found.name).collect()
    }

    /// Returns the entry of a model, on the first device if none is named. May unload another model, and blocks while
    /// its threads end.
    ///
    /// # Errors
    /// If the model does not exist or has an error, if the device is not offered, or if all entries are in use.
    pub(super) fn shelf(&self, name: &Slug, device: Option<&str>) -> Result<Arc<Shelf>, LoadError> {
        let found = self.folders.find(name.as_str())?;
        found.card?;
        let devices = &self.config.devices;
        let other = |asked: &str| LoadError::OtherDevice {
            model: name.to_string(),
            asked: asked.to_owned(),
            offered: devices.join(", "),
        };
        let device = match device {
            Some(asked) => devices.iter().find(|offered| *offered == asked).ok_or_else(|| other(asked))?,
            None => devices.first().ok_or_else(|| other("any device"))?,
        };
        let stamp = Stamp::of(&found.folder);
        let (shelf, unloaded) = {
            let mut shelves = self.lock();
            let unloaded = make_room(&mut shelves, name, device, &stamp, self.config.most_loaded.get())?;
            let kept = shelves.iter().position(|shelf| is(shelf, name, device));
            let shelf = match kept {
                Some(at) => shelves.remove(at),
                None => Shelf::new(self.config.model(name, &found.folder, device), Some(stamp)),
            };
            shelves.push(Arc::clone(&shelf));
            (shelf, unloaded)
        };
        // The old models are unloaded before the caller loads the new one, so that the limit is never exceeded.
        for old in unloaded {
            tracing::info!(model = %old.config.name(), device = old.config.device(), "unloaded a model of the bank");
            old.clear();
        }
        Ok(shelf)
    }

    /// Removes an entry whose model could not be loaded.
    pub(super) fn discard(&self, failed: &Arc<Shelf>) {
        // Other callers may be retrying at this moment; then the last of them removes the entry.
        self.lock().retain(|shelf| {
            !(Arc::ptr_eq(shelf, failed) && Arc::strong_count(shelf) == 2 && shelf.is_idle())
        });
    }

    pub(super) fn shelves(&self) -> Vec<Arc<Shelf>> {
        self.lock().clone()
    }

    /// Checks the folders and limits; returns each error with its key.
    pub(super) fn check(&self) -> Vec<(&'static str, LoadError)> {
        let mut errors: Vec<_> = self.folders.check().into_iter().map(|error| ("folders", error)).collect();
        let (value, most) = (self.config.most_loaded.get(), BankConfig::MOST_LOADED);
        if value > most {
            let (value, most) = (value as u64, most as u64);
            errors.push(("most_loaded", LoadError::TooMuch { key: "most_loaded", value, most }));
        }
        let anything = self.config.model(&Slug::any(), Path::new("."), "cpu");
        if let Err(LoadError::TooMuch { key, value, most }) = anything.check_limits() {
            errors.push((key, LoadError::TooMuch { key, value, most }));
        }
        for device in &self.config.devices {
            if let Err(error) = crate::model::onnx::check_device(device) {
                errors.push(("devices", error));
            }
        }
        errors
    }

    /// Locks the entries. No code panics while it holds the lock, so that the state behind a poisoned lock is
    /// consistent.
    fn lock(&self) -> MutexGuard<'_, Vec<Arc<Shelf>>> {
        self.shelves.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn is(shelf: &Shelf, name: &Slug, device: &str) -> bool {
    shelf.config.name() == name && shelf.config.device() == device
}

/// Removes and returns the entries that have to be unloaded for the requested model.
fn make_room(
    shelves: &mut Vec<Arc<Shelf>>,
    name: &Slug,
    device: &str,
    stamp: &Stamp,
    most: usize,
) -> Result<Vec<Arc<Shelf>>, LoadError> {
    // While the lock is held, no caller can get hold of an entry that only the list holds.
    let idle = |shelf: &Arc<Shelf>| Arc::strong_count(shelf) == 1 && shelf.is_idle();
    if let Some(at) = shelves.iter().position(|shelf| is(shelf, name, device)) {
        if shelves[at].stamp.as_ref() == Some(stamp) {
            return Ok(Vec::new());
        }
        // The files have changed. Two versions of one model must not be in use at the same time.
        if !idle(&shelves[at]) {
            return Err(LoadError::Changed(name.to_string()));
        }
        return Ok(vec![shelves.remove(at)]);
    }
    if shelves.len() < most {
        return Ok(Vec::new());
    }
    match shelves.iter().position(idle) {
        Some(at) => Ok(vec![shelves.remove(at)]),
        None => {
            let in_use =
                shelves.iter().map(|shelf| format!("{} on {}", shelf.config.name(), shelf.config.device()));
            Err(LoadError::BankFull { model: name.to_string(), most, in_use: in_use.collect() })
        }
    }
}
