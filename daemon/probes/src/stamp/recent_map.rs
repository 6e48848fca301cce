//! A table of bounded size that forgets the least recently used entries.

use std::collections::HashMap;
use std::hash::Hash;

/// A map of two generations. An entry that is used moves to the young generation. When that is full, it becomes the old
/// one, and the previous old generation is forgotten. All operations take constant time. A crowd of new keys makes the
/// table forget old ones, but the table never refuses a key.
#[derive(Debug)]
pub(super) struct RecentMap<K, V> {
    young: HashMap<K, V>,
    old: HashMap<K, V>,
    generation: usize,
}

impl<K: Eq + Hash, V> RecentMap<K, V> {
    /// Creates a table that remembers at least the `generation` most recently used keys, and at most twice as many.
    pub(super) fn new(generation: usize) -> Self {
        Self { young: HashMap::new(), old: HashMap::new(), generation }
    }

    /// Returns the value of the key, and creates it if necessary.
    pub(super) fn entry(&mut self, key: K, new: impl FnOnce() -> V) -> &mut V {
        let known = self.old.remove(&key);
        if self.young.len() >= self.generation && !self.young.contains_key(&key) {
            self.old = std::mem::take(&mut self.young);
        }
        self.young.entry(key).or_insert_with(|| known.unwrap_or_else(new))
    }

    /// Returns the value of the key, if it is remembered.
    pub(super) fn get_mut(&mut self, key: &K) -> Option<&mut V> {
        self.young.get_mut(key).or_else(|| self.old.get_mut(key))
    }
}
