//! Identifiers of hosts and runs, and names for people.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

/// Defines a type of random 16-byte identifiers.
#[macro_export]
macro_rules! random_id {
    ($(#[$doc:meta])* $id:ident) => {
        $(#[$doc])*
        #[derive(
            Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, ::serde::Serialize, ::serde::Deserialize,
        )]
        #[serde(transparent)]
        pub struct $id(::uuid::Uuid);

        impl $id {
            /// Creates a random id.
            pub fn random() -> Self {
                Self(::uuid::Uuid::new_v4())
            }

            /// Returns the 16 bytes of the id.
            pub fn as_bytes(&self) -> &[u8; 16] {
                self.0.as_bytes()
            }

            /// Creates the id with the given bytes.
            pub fn from_bytes(bytes: [u8; 16]) -> Self {
                Self(::uuid::Uuid::from_bytes(bytes))
            }
        }

        impl ::std::fmt::Display for $id {
            fn fmt(&self, f: &mut ::std::fmt::Formatter<'_>) -> ::std::fmt::Result {
                ::std::fmt::Display::fmt(&self.0, f)
            }
        }

        impl ::std::str::FromStr for $id {
            type Err = ::uuid::Error;
            fn from_str(text: &str) -> Result<Self, Self::Err> {
                text.parse().map(Self)
            }
        }
    };
}
random_id! {
    /// Random identifier of a host, kept in the agent's state directory. It stays the same when the host is renamed.
    HostId
}

random_id! {
    /// Identifier of a run: one pipeline configuration executed for many iterations.
    RunId
}

/// Name of a host, a pipeline or a model for people: 1 to 64 characters of `A-Z a-z 0-9 . _ -`, of which the first is a
/// letter or digit. Such a name needs no escaping in addresses, file names and tables.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Slug(Arc<str>);

/// Error: the text is not a valid name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} cannot be a name: use 1 to 64 letters, digits, dots, underscores and hyphens, a letter or digit first"
)]
pub struct InvalidName(pub String);

impl Slug {
    /// Maximum number of characters.
    pub const MAX_CHARS: usize = 64;

    /// Returns the name as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Returns `any`, the placeholder for a model that the peer has not chosen yet.
    pub fn any() -> Self {
        Self("any".into())
    }

    /// Returns `none`, the placeholder for a missing name.
    pub fn none() -> Self {
        Self("none".into())
    }

    /// Returns `observed`, which replaces the model's name if PEERNet only observes the nodes of another system.
    pub fn observed() -> Self {
        Self("observed".into())
    }
}

impl TryFrom<String> for Slug {
    type Error = InvalidName;
    fn try_from(name: String) -> Result<Self, InvalidName> {
        let starts_alphanumeric = name.bytes().next().is_some_and(|byte| byte.is_ascii_alphanumeric());
        let has_valid_bytes = name.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"._-".contains(&byte));
        if starts_alphanumeric && has_valid_bytes && name.len() <= Self::MAX_CHARS {
            Ok(Self(name.into()))
        } else {
            Err(InvalidName(name))
        }
    }
}

impl FromStr for Slug {
    type Err = InvalidName;
    fn from_str(name: &str) -> Result<Self, InvalidName> {
        Self::try_from(name.to_owned())
    }
}

impl From<Slug> for String {
    fn from(name: Slug) -> Self {
        name.0.as_ref().to_owned()
    }
}

impl fmt::Display for Slug {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // `pad` applies the width and alignment of a format; `write_str` would ignore them.
        f.pad(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_need_escaping_are_refused() {
        for good in ["a", "cam-1", "rack_a.2", "9"] {
            assert!(good.parse::<Slug>().is_ok(), "{good}");
        }
        for bad in ["", "-a", ".a", "a/b", "a b", "ä", &"x".repeat(65)] {
            assert!(bad.parse::<Slug>().is_err(), "{bad}");
        }
    }
}
