//! Kinds of the two clocks that a relation relates.

use std::fmt;

use serde::{Deserialize, Serialize};

/// The clocks of the two hosts that stamp the exchanges.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RelatedClocks {
    /// The free-running clocks (`CLOCK_MONOTONIC_RAW`) of both hosts: no time daemon steps or slews them.
    #[default]
    Raw,
    /// The free-running clock of the edge and the wall clock of the cloud. Steps and slews of the wall clock move the
    /// offset. Used with a cloud of session protocol 4, and with a STAMP reflector that is not PEERNet's.
    RawToWall,
    /// The wall clocks of both hosts. Used only for runs recorded before version 0.3.0.
    Wall,
}

impl RelatedClocks {
    /// All values, in the order of declaration.
    pub const ALL: &'static [Self] = &[Self::Raw, Self::RawToWall, Self::Wall];

    /// Returns the name used in storage, in the API and on the pages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Raw => "raw",
            Self::RawToWall => "raw-to-wall",
            Self::Wall => "wall",
        }
    }

    /// Returns the value with a name; `None` for an unknown name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|value| value.name() == name)
    }

    /// Describes the clocks in words, for sentences on pages and in terminals.
    pub const fn words(self) -> &'static str {
        match self {
            Self::Raw => "free-running clocks",
            Self::RawToWall => "the edge's raw and the cloud's wall clock",
            Self::Wall => "wall clocks",
        }
    }

    /// Returns whether no time daemon can move the offset between the two clocks.
    pub const fn are_free_running(self) -> bool {
        matches!(self, Self::Raw)
    }
}

impl fmt::Display for RelatedClocks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip_and_match_serialised_form() {
        for clocks in RelatedClocks::ALL {
            assert_eq!(RelatedClocks::from_name(clocks.name()), Some(*clocks));
            assert_eq!(serde_json::to_string(clocks).expect("serialises"), format!("\"{clocks}\""));
        }
    }
}
