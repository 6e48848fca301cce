//! A map of bounded size that drops the least recently used entries.

use std::collections::HashMap;
use std::hash::Hash;

/// A map of two generations. [`entry`](Self::entry) moves an entry to the young generation. When the young generation
/// is full, it becomes the old generation, and the entries of the previous old generation are dropped. All operations
/// take constant time. A flood of new keys evicts older keys, but no key is refused.
#[derive(Debug)]
pub(super) struct RecentMap<K, V> {
    young: HashMap<K, V>,
    old: HashMap<K, V>,
    /// Maximum number of entries of each generation.
    generation_size: usize,
}

impl<K: Eq + Hash, V> RecentMap<K, V> {
    /// Creates a map that keeps at least the `generation_size` most recently used keys, and at most twice as many.
    pub(super) fn new(generation_size: usize) -> Self {
        Self { young: HashMap::new(), old: HashMap::new(), generation_size }
    }

    /// Returns the value of the key; inserts a new value if the key is missing.
    pub(super) fn entry(&mut self, key: K, new_value: impl FnOnce() -> V) -> &mut V {
        let old_value = self.old.remove(&key);
        if self.young.len() >= self.generation_size && !self.young.contains_key(&key) {
            self.old = std::mem::take(&mut self.young);
        }
        self.young.entry(key).or_insert_with(|| old_value.unwrap_or_else(new_value))
    }

    /// Returns the value of the key, if there is one.
    pub(super) fn get_mut(&mut self, key: &K) -> Option<&mut V> {
        self.young.get_mut(key).or_else(|| self.old.get_mut(key))
    }
}
