//! Cache of the loaded models of the bank's folders, limited in number.

use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use peernet_logger::Slug;

use super::cache_entry::{CacheEntry, FilesStamp};
use super::{BankConfig, ModelFolders, UnloadReason};
use crate::LoadError;

/// Models of the folders that are loaded or being loaded.
pub(super) struct ModelCache {
    config: BankConfig,
    folders: ModelFolders,
    /// Entries in the order of their last requests. The entry that was requested longest ago comes first.
    entries: Mutex<Vec<Arc<CacheEntry>>>,
}

impl ModelCache {
    pub(super) fn new(config: BankConfig) -> Self {
        let folders = ModelFolders::new(config.folders.iter().cloned());
        Self { config, folders, entries: Mutex::default() }
    }

    /// Returns the names of the models on disk that can be requested.
    pub(super) fn names(&self) -> Vec<Slug> {
        // If no device is offered, no model of the folders can be requested.
        if self.config.devices.is_empty() {
            return Vec::new();
        }
        let usable =
            self.folders.list().into_iter().filter(|found| found.shadowed_by.is_none() && found.card.is_ok());
        usable.map(|found| found.name).collect()
    }

    /// Returns the entry of a model, and the entries that the caller must unload before it loads the model. `None` as
    /// device stands for the first offered device.
    ///
    /// # Errors
    /// If the model does not exist or has an error, if the host does not offer the device or offers none, or if all
    /// entries are in use.
    pub(super) fn entry(
        &self,
        name: &Slug,
        device: Option<&str>,
    ) -> Result<(Arc<CacheEntry>, ToUnload), LoadError> {
        let found = self.folders.find(name.as_str())?;
        found.card?;
        let devices = &self.config.devices;
        let first = devices.first().ok_or_else(|| LoadError::NoDevice(name.to_string()))?;
        let device = match device {
            Some(requested) => devices.iter().find(|offered| *offered == requested).ok_or_else(|| {
                LoadError::OtherDevice {
                    model: name.to_string(),
                    requested: requested.to_owned(),
                    offered: devices.join(", "),
                }
            })?,
            None => first,
        };
        let stamp = FilesStamp::read(&found.folder);
        let mut entries = self.lock();
        let to_unload = entries_to_unload(&mut entries, name, device, &stamp, self.config.max_loaded.get())?;
        let existing = entries.iter().position(|entry| is_entry_of(entry, name, device));
        let entry = match existing {
            Some(index) => entries.remove(index),
            None => CacheEntry::new(self.config.model(name, &found.folder, device), Some(stamp)),
        };
        entries.push(Arc::clone(&entry));
        Ok((entry, to_unload))
    }

    /// Removes an entry whose model could not be loaded.
    pub(super) fn discard(&self, failed: &Arc<CacheEntry>) {
        // Other callers may be loading the same model again at this moment. The last of them then removes the entry.
        self.lock().retain(|entry| {
            // The list and the caller hold one reference each.
            !(Arc::ptr_eq(entry, failed) && Arc::strong_count(entry) == 2 && entry.is_idle())
        });
    }

    pub(super) fn entries(&self) -> Vec<Arc<CacheEntry>> {
        self.lock().clone()
    }

    /// Checks the folders and limits; returns each error with its key.
    pub(super) fn check(&self) -> Vec<(&'static str, LoadError)> {
        let mut errors: Vec<_> = self.folders.check().into_iter().map(|error| ("folders", error)).collect();
        // The configuration has `max_loaded` under the key `most_loaded`.
        let (value, max) = (self.config.max_loaded.get(), BankConfig::MAX_LOADED);
        if value > max {
            let (value, max) = (value as u64, max as u64);
            errors.push(("most_loaded", LoadError::AboveLimit { key: "most_loaded", value, max }));
        }
        // `check_limits()` needs the configuration of a model. Any model serves, because all models of the folders have
        // the limited keys of `[bank]`.
        let any_model = self.config.model(&Slug::any(), Path::new("."), "cpu");
        if let Err(LoadError::AboveLimit { key, value, max }) = any_model.check_limits() {
            errors.push((key, LoadError::AboveLimit { key, value, max }));
        }
        for device in &self.config.devices {
            if let Err(error) = crate::model::onnx::check_device(device) {
                errors.push(("devices", error));
            }
        }
        errors
    }

    /// Locks the entries. No code panics while it holds the lock, so the state behind a poisoned lock is
    /// consistent.
    fn lock(&self) -> MutexGuard<'_, Vec<Arc<CacheEntry>>> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn is_entry_of(entry: &CacheEntry, name: &Slug, device: &str) -> bool {
    entry.config.name() == name && entry.config.device() == device
}

/// Entries that have to be unloaded, each with the reason.
pub(super) type ToUnload = Vec<(Arc<CacheEntry>, UnloadReason)>;

/// Removes and returns the entries that have to be unloaded for the requested model.
fn entries_to_unload(
    entries: &mut Vec<Arc<CacheEntry>>,
    name: &Slug,
    device: &str,
    stamp: &FilesStamp,
    max: usize,
) -> Result<ToUnload, LoadError> {
    // The caller holds the lock of the list, so no other thread can get an entry that only the list references.
    let is_idle = |entry: &Arc<CacheEntry>| Arc::strong_count(entry) == 1 && entry.is_idle();
    if let Some(index) = entries.iter().position(|entry| is_entry_of(entry, name, device)) {
        if entries[index].stamp.as_ref() == Some(stamp) {
            return Ok(Vec::new());
        }
        // The files have changed. Two versions of one model must not be in use at the same time.
        if !is_idle(&entries[index]) {
            return Err(LoadError::Changed(name.to_string()));
        }
        return Ok(vec![(entries.remove(index), UnloadReason::FilesChanged)]);
    }
    if entries.len() < max {
        return Ok(Vec::new());
    }
    match entries.iter().position(is_idle) {
        Some(index) => Ok(vec![(entries.remove(index), UnloadReason::MakesRoomFor(name.clone()))]),
        None => {
            let in_use =
                entries.iter().map(|entry| format!("{} on {}", entry.config.name(), entry.config.device()));
            Err(LoadError::BankFull { model: name.to_string(), max, in_use: in_use.collect() })
        }
    }
}
