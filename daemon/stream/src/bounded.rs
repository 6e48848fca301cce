//! Lists from an untrusted peer, with a limit on their length: one byte on the wire may take many bytes in memory.

use std::fmt;
use std::marker::PhantomData;

use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

/// Reads a list of at most `MAX` items. A longer list is refused before it is in memory.
pub(super) fn at_most<'de, const MAX: usize, T, D>(deserializer: D) -> Result<Vec<T>, D::Error>
where
    T: Deserialize<'de>,
    D: Deserializer<'de>,
{
    deserializer.deserialize_seq(BoundedListVisitor::<MAX, T>(PhantomData))
}

struct BoundedListVisitor<const MAX: usize, T>(PhantomData<T>);

impl<'de, const MAX: usize, T: Deserialize<'de>> Visitor<'de> for BoundedListVisitor<MAX, T> {
    type Value = Vec<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "at most {MAX} items")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Vec<T>, A::Error> {
        // The list grows with the items that arrive. The length that precedes the items is only stated by the peer.
        let mut list = Vec::new();
        while let Some(item) = items.next_element()? {
            if list.len() == MAX {
                return Err(A::Error::custom(format_args!("a list of more than {MAX} items")));
            }
            list.push(item);
        }
        Ok(list)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Deserialize)]
    #[serde(transparent)]
    struct ShortList(#[serde(deserialize_with = "at_most::<3, _, _>")] Vec<u8>);

    #[test]
    fn too_long_list_is_refused() {
        let read = |items: usize| {
            let bytes = rmp_serde::to_vec(&vec![7_u8; items]).expect("a list can be serialised");
            rmp_serde::from_slice::<ShortList>(&bytes)
        };
        assert_eq!(read(0).expect("an empty list is short enough").0, [0; 0]);
        assert_eq!(read(3).expect("a list of 3 items is short enough").0, [7; 3]);
        let error = read(4).expect_err("a list of 4 items is too long").to_string();
        assert!(error.contains("more than 3"), "{error}");
    }
}
