//! List that grows without moving its elements.

use std::ops::Index;

/// Number of elements in one chunk.
const CHUNK_LEN: usize = 4096;

/// List that only grows. It needs little more memory than its elements, and it leaves no freed blocks behind. A vector
/// needs up to three times the memory of its elements while it moves them to a larger block, and a run has dozens of
/// columns that grow at the same time.
#[derive(Clone, Debug)]
pub(super) struct Chunks<T>(Vec<Vec<T>>);

impl<T> Default for Chunks<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T> Chunks<T> {
    pub(super) fn len(&self) -> usize {
        self.0.last().map_or(0, |last| (self.0.len() - 1) * CHUNK_LEN + last.len())
    }

    pub(super) fn push(&mut self, value: T) {
        match self.0.last_mut().filter(|last| last.len() < CHUNK_LEN) {
            Some(last) => last.push(value),
            None => {
                let mut chunk = Vec::with_capacity(CHUNK_LEN);
                chunk.push(value);
                self.0.push(chunk);
            }
        }
    }
}

impl<T> Index<usize> for Chunks<T> {
    type Output = T;

    fn index(&self, index: usize) -> &T {
        &self.0[index / CHUNK_LEN][index % CHUNK_LEN]
    }
}

impl<T> FromIterator<T> for Chunks<T> {
    fn from_iter<I: IntoIterator<Item = T>>(values: I) -> Self {
        let mut list = Self::default();
        values.into_iter().for_each(|value| list.push(value));
        list
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_element_is_found_at_its_index() {
        for count in [0, 1, CHUNK_LEN, CHUNK_LEN + 1, 3 * CHUNK_LEN] {
            let list: Chunks<usize> = (0..count).collect();
            assert_eq!(list.len(), count);
            assert!((0..count).all(|at| list[at] == at), "{count}");
        }
    }
}
