//! The models of the bank's folders that are in memory: few, and never one too many.

use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use peernet_logger::Slug;

use super::shelf::{Shelf, Stamp};
use super::{BankConfig, ModelFolders};
use crate::LoadError;

pub(super) struct Stock {
    config: BankConfig,
    folders: ModelFolders,
    /// The one that was asked for longest ago comes first.
    shelves: Mutex<Vec<Arc<Shelf>>>,
}

impl Stock {
    pub(super) fn new(config: BankConfig) -> Self {
        let folders = ModelFolders::of(config.folders.iter().cloned());
        Self { config, folders, shelves: Mutex::default() }
    }

    /// The names of the models on disk that can be asked for.
    pub(super) fn names(&self) -> Vec<Slug> {
        if self.config.devices.is_empty() {
            return Vec::new();
        }
        let usable =
            self.folders.list().into_iter().filter(|found| found.hidden_by.is_none() && found.card.is_ok());
        usable.map(|found| found.name).collect()
    }

    /// The place of a model, on the first device when none is named. Another model may have had to go: blocks while its
    /// threads end.
    ///
    /// # Errors
    /// When there is no such model, something is wrong with it, the device is not offered, or all places are taken by
    /// models in use.
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
        // Before the next one is loaded, so that there is never one more in memory.
        for old in unloaded {
            tracing::info!(model = %old.config.name(), device = old.config.device(), "unloaded a model of the bank");
            old.clear();
        }
        Ok(shelf)
    }

    /// Takes a shelf away on which nothing could be put.
    pub(super) fn discard(&self, failed: &Arc<Shelf>) {
        // Others may be trying again just now; the last of them takes it away.
        self.lock().retain(|shelf| {
            !(Arc::ptr_eq(shelf, failed) && Arc::strong_count(shelf) == 2 && shelf.is_idle())
        });
    }

    pub(super) fn shelves(&self) -> Vec<Arc<Shelf>> {
        self.lock().clone()
    }

    /// What is wrong with the folders; the second is the key.
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

    /// Nothing in here can panic half-way, so that a poisoned lock still guards a whole state.
    fn lock(&self) -> MutexGuard<'_, Vec<Arc<Shelf>>> {
        self.shelves.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn is(shelf: &Shelf, name: &Slug, device: &str) -> bool {
    shelf.config.name() == name && shelf.config.device() == device
}

/// Takes out what has to go so that the wanted model finds its place.
fn make_room(
    shelves: &mut Vec<Arc<Shelf>>,
    name: &Slug,
    device: &str,
    stamp: &Stamp,
    most: usize,
) -> Result<Vec<Arc<Shelf>>, LoadError> {
    // Under the lock nobody can take a shelf in hand that is in the list alone.
    let idle = |shelf: &Arc<Shelf>| Arc::strong_count(shelf) == 1 && shelf.is_idle();
    if let Some(at) = shelves.iter().position(|shelf| is(shelf, name, device)) {
        if shelves[at].stamp.as_ref() == Some(stamp) {
            return Ok(Vec::new());
        }
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
