//! Versions of a protocol: the range that each end supports, and the highest version that both support.
//!
//! The event stream and the session protocol negotiate their versions as follows. The end that connects states its
//! range and the first release that supports the oldest version in it. The other end chooses the highest version that
//! both support and states it: the aggregator in its challenge, the cloud when it accepts a session. Without a common
//! version the connection is refused, with a text that names the end to update and the release that it needs. The older
//! end cannot know that release by itself; the range that the newer end states contains the release.
//!
//! A release that changes messages raises the newest version of its range. On connections for which an older version
//! was chosen, the release still writes the older forms. Messages that are sent before a version is chosen (hello,
//! refusal) never change their form, except for named values in a hello's extension. Events are encoded and hashed
//! before their aggregator is known, and wait in the spool; an agent therefore supports no version older than the form
//! of its events, and aggregators are updated first.

use std::fmt;

use serde::{Deserialize, Serialize};

/// A release of PEERNet: major, minor and patch version.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Release(pub u16, pub u16, pub u16);

impl fmt::Display for Release {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(major, minor, patch) = self;
        write!(f, "PEERNet {major}.{minor}.{patch}")
    }
}

/// Versions of a protocol that one end supports.
///
/// The range that PEERNet 0.1.0 states contains one version.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct VersionRange {
    /// Oldest supported version.
    // PEERNet 0.1.0 reads only the field `protocol`. Because of this name, PEERNet 0.1.0 can serve a later peer that
    // still supports the version of 0.1.0.
    #[serde(rename = "protocol")]
    pub(crate) oldest: u16,
    /// Newest supported version; `None` if the range contains one version.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) newest: Option<u16>,
    /// First release that supports `oldest`; `None` if it is not stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) since: Option<Release>,
}

impl VersionRange {
    /// Creates a range; `since` is the first release that supports `oldest`.
    pub const fn new(oldest: u16, newest: u16, since: Release) -> Self {
        Self { oldest, newest: Some(newest), since: Some(since) }
    }

    /// Creates a range of one version.
    pub const fn single(version: u16) -> Self {
        Self { oldest: version, newest: None, since: None }
    }

    /// Returns the oldest version.
    pub const fn oldest(&self) -> u16 {
        self.oldest
    }

    /// Returns the newest version. The result is never below the oldest version, even if a peer states such a range.
    pub fn newest(&self) -> u16 {
        self.newest.map_or(self.oldest, |newest| newest.max(self.oldest))
    }

    /// Returns the highest version that both ends support.
    ///
    /// # Errors
    /// If they have no version in common.
    pub fn highest_common(&self, peer: &Self) -> Result<u16, VersionMismatch> {
        let highest = self.newest().min(peer.newest());
        if highest < self.oldest.max(peer.oldest) {
            return Err(VersionMismatch { here: *self, peer: *peer });
        }
        Ok(highest)
    }
}

impl fmt::Display for VersionRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.oldest, self.newest()) {
            (oldest, newest) if oldest == newest => write!(f, "version {oldest}"),
            (oldest, newest) => write!(f, "versions {oldest} to {newest}"),
        }
    }
}

/// Error for two ends that have no version of a protocol in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VersionMismatch {
    /// Versions that this end supports.
    pub here: VersionRange,
    /// Versions that the peer supports.
    pub peer: VersionRange,
}

impl VersionMismatch {
    /// Returns the error text, which names the end to update and the release that it needs. `protocol`, `here` and
    /// `peer` name the protocol, this end and the peer, such as `the event stream`, `the aggregator` and `the agent on
    /// edge`.
    pub fn describe(&self, protocol: &str, here: &str, peer: &str) -> String {
        let (here, peer) = ((here, self.here), (peer, self.peer));
        let is_peer_older = peer.1.newest() < here.1.oldest;
        let ((older, older_range), (newer, newer_range)) =
            if is_peer_older { (peer, here) } else { (here, peer) };
        // The end that is too old cannot know which release supports a newer version.
        let needed =
            newer_range.since.map_or_else(|| format!("the release of {newer}"), |since| since.to_string());
        format!(
            "{older} speaks {older_range} of {protocol}, {newer} speaks {newer_range}: update {older} to at least {needed}"
        )
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn range(oldest: u16, newest: u16) -> VersionRange {
        VersionRange::new(oldest, newest, Release(0, oldest, 0))
    }

    #[test]
    fn highest_common_version_is_chosen() {
        let own = range(5, 7);
        for (peer, chosen) in [
            (VersionRange::single(5), 5),
            (VersionRange::single(7), 7),
            (range(3, 6), 6),
            (range(6, 9), 7),
            (range(1, 9), 7),
            (own, 7),
        ] {
            assert_eq!(own.highest_common(&peer), Ok(chosen), "{peer}");
            assert_eq!(peer.highest_common(&own), Ok(chosen), "{peer}");
        }
    }

    #[test]
    fn mismatch_names_older_end_and_needed_release() {
        let text = |here: VersionRange, peer: VersionRange| {
            let mismatch = here.highest_common(&peer).expect_err("the ranges have no version in common");
            mismatch.describe("the event stream", "the aggregator", "the agent on edge")
        };
        assert_eq!(
            text(range(6, 7), VersionRange::single(5)),
            "the agent on edge speaks version 5 of the event stream, the aggregator speaks versions 6 to 7: update the \
             agent on edge to at least PEERNet 0.6.0"
        );
        assert_eq!(
            text(range(5, 5), range(6, 7)),
            "the aggregator speaks version 5 of the event stream, the agent on edge speaks versions 6 to 7: update the \
             aggregator to at least PEERNet 0.6.0"
        );
        let unstated = text(range(5, 5), VersionRange::single(9));
        assert!(
            unstated.ends_with("update the aggregator to at least the release of the agent on edge"),
            "{unstated}"
        );
    }

    proptest! {
        #[test]
        fn both_ends_choose_same_version_from_any_ranges(
            a: u16, b in any::<Option<u16>>(), c: u16, d in any::<Option<u16>>(),
        ) {
            let here = VersionRange { oldest: a, newest: b, since: None };
            let peer = VersionRange { oldest: c, newest: d, since: None };
            let supports = |range: VersionRange, version| (range.oldest()..=range.newest()).contains(&version);
            match (here.highest_common(&peer), peer.highest_common(&here)) {
                (Ok(version), other) => {
                    prop_assert_eq!(other, Ok(version));
                    prop_assert!(supports(here, version) && supports(peer, version));
                    prop_assert!(version == here.newest() || version == peer.newest());
                }
                (Err(_), other) => {
                    prop_assert!(other.is_err());
                    prop_assert!(here.newest() < peer.oldest() || peer.newest() < here.oldest());
                }
            }
        }
    }
}
