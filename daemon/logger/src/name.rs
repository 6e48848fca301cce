//! Names of nodes, kinds and units.

pub mod stage;

use std::borrow::Borrow;
use std::fmt;
use std::hash::{Hash, Hasher};
use std::sync::Arc;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::limits::MAX_NAME_BYTES;

/// A short text that is cloned without copying. Standard names are static texts; all other names are shared.
///
/// A name has at most [`MAX_NAME_BYTES`] bytes. A longer text of this program is truncated. A longer text of a peer is
/// refused.
#[derive(Clone)]
pub struct Name(Repr);

#[derive(Clone)]
enum Repr {
    Static(&'static str),
    Shared(Arc<str>),
}

impl Name {
    /// Creates a name from a string constant.
    ///
    /// # Panics
    /// If the name is longer than [`MAX_NAME_BYTES`]; in a constant, this is a compile error.
    pub const fn from_static(name: &'static str) -> Self {
        assert!(name.len() <= MAX_NAME_BYTES, "the name is longer than MAX_NAME_BYTES");
        Self(Repr::Static(name))
    }

    /// Returns the name as text.
    pub fn as_str(&self) -> &str {
        match &self.0 {
            Repr::Static(name) => name,
            Repr::Shared(name) => name,
        }
    }
}

impl From<&str> for Name {
    /// Creates a name, truncated to [`MAX_NAME_BYTES`]. Standard names with a number on the wire need no allocation.
    fn from(name: &str) -> Self {
        let name = &name[..name.floor_char_boundary(MAX_NAME_BYTES)];
        stage::standard(name).map_or_else(|| Self(Repr::Shared(name.into())), Self::from_static)
    }
}

impl From<String> for Name {
    fn from(name: String) -> Self {
        Self::from(name.as_str())
    }
}

impl std::ops::Deref for Name {
    type Target = str;
    fn deref(&self) -> &str {
        self.as_str()
    }
}

impl Borrow<str> for Name {
    fn borrow(&self) -> &str {
        self.as_str()
    }
}

impl PartialEq for Name {
    fn eq(&self, other: &Self) -> bool {
        self.as_str() == other.as_str()
    }
}

impl PartialEq<str> for Name {
    fn eq(&self, other: &str) -> bool {
        self.as_str() == other
    }
}

impl PartialEq<&str> for Name {
    fn eq(&self, other: &&str) -> bool {
        self.as_str() == *other
    }
}

impl Eq for Name {}

impl PartialOrd for Name {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Name {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.as_str().cmp(other.as_str())
    }
}

impl Hash for Name {
    fn hash<H: Hasher>(&self, state: &mut H) {
        // Only the text is hashed, as `Borrow<str>` requires: a static and a shared name with the same text are equal.
        self.as_str().hash(state);
    }
}

impl fmt::Debug for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.as_str(), f)
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl Serialize for Name {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
    }
}

impl<'de> Deserialize<'de> for Name {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl serde::de::Visitor<'_> for Visitor {
            type Value = Name;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a name")
            }
            fn visit_str<E: serde::de::Error>(self, name: &str) -> Result<Name, E> {
                // A long name is refused and not truncated: two different names of a peer could become equal.
                if name.len() > MAX_NAME_BYTES {
                    return Err(E::custom(format_args!(
                        "a name has {} bytes, the limit is {MAX_NAME_BYTES}",
                        name.len()
                    )));
                }
                Ok(Name::from(name))
            }
        }
        deserializer.deserialize_str(Visitor)
    }
}

/// A unit of measurement: the symbol of an SI unit, or a custom unit.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Unit(Name);

impl Unit {
    /// Seconds.
    pub const SECONDS: Self = Self(Name::from_static("s"));
    /// Bytes.
    pub const BYTES: Self = Self(Name::from_static("B"));
    /// Bits per second.
    pub const BITS_PER_SECOND: Self = Self(Name::from_static("bit/s"));
    /// Tokens per second.
    pub const TOKENS_PER_SECOND: Self = Self(Name::from_static("token/s"));
    /// Watts.
    pub const WATTS: Self = Self(Name::from_static("W"));
    /// Degrees Celsius.
    pub const CELSIUS: Self = Self(Name::from_static("°C"));
    /// Joules.
    pub const JOULES: Self = Self(Name::from_static("J"));
    /// Tokens of a language model.
    pub const TOKENS: Self = Self(Name::from_static("token"));
    /// No unit: a plain number.
    pub const NONE: Self = Self(Name::from_static(""));

    /// Creates a unit with a symbol.
    pub fn new(symbol: &str) -> Self {
        Self(symbol.into())
    }

    /// Returns the symbol.
    pub fn symbol(&self) -> &str {
        self.0.as_str()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_name_is_truncated_locally_but_refused_from_peer() {
        let long = "ä".repeat(MAX_NAME_BYTES);
        let name = Name::from(long.as_str());
        assert_eq!(name.as_str(), "ä".repeat(MAX_NAME_BYTES / 2));
        assert!(serde_json::from_str::<Name>(&format!("\"{name}\"")).is_ok());
        assert!(serde_json::from_str::<Name>(&format!("\"{name}x\"")).is_err());
    }

    #[test]
    fn standard_name_is_static_and_custom_name_is_shared() {
        assert_eq!(Name::from("sensing"), stage::SENSING);
        assert!(matches!(Name::from("sensing").0, Repr::Static(_)));
        assert!(matches!(Name::from("gripper").0, Repr::Shared(_)));
    }
}
