//! The hello: the first message of an agent.

use peernet_logger::random_id;
use serde::ser::SerializeMap;
use serde::{Deserialize, Serialize, Serializer};

use crate::{Chain, HostDescription, Release, VersionRange};

/// Versions of the event stream that an aggregator of this release speaks.
pub const STREAM_VERSIONS: VersionRange = VersionRange::new(5, 7, Release(0, 1, 0));

/// Versions that an agent of this release speaks. Its events may have raw stamps, which version 7 added, and are encoded before it is
/// known which aggregator they go to.
pub const AGENT_STREAM_VERSIONS: VersionRange = VersionRange::new(7, 7, Release(0, 3, 0));

/// The only version that PEERNet 0.1.0 speaks.
const FIRST_VERSION: u16 = 5;

random_id! {
    /// A stream of batches: made with the agent's spool, so that a new or copied spool is recognised.
    StreamId
}

/// Who connects.
///
/// It is sent before a version is chosen, so that its form never changes: what a later version adds goes into the extension.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// Oldest version of the event stream that the agent speaks.
    pub protocol: u16,
    /// The host and what it is.
    pub host: HostDescription,
    /// The stream its batches belong to.
    pub stream: StreamId,
    /// The stream that this one goes on from, where the agent had to leave one: nothing is missing between the two.
    pub previous: Option<StreamId>,
    /// Number of the first batch that there ever was in the stream.
    pub first: u64,
    /// Number of the oldest batch the agent still holds; one more than the newest when it holds none.
    pub oldest: u64,
    /// Chain of the batch before `oldest`.
    pub before: Chain,
    /// Number of events in all batches of the spool before `oldest`: by it the aggregator knows how many it lacks.
    pub events_before_oldest: u64,
    /// Number of events in all batches of the spool before `first`, in earlier streams; `None` when it is not known.
    pub events_before_first: Option<u64>,
    /// Longest body of a batch that the agent cuts, as a rule; bytes. Windows are counted in the weight of such a batch.
    pub batch_bytes: u32,
    /// A random number made at process start: tells a reconnect from a second process with a copied host id.
    pub process: u64,
    /// What was not in the hello of PEERNet 0.1.0; `None` where there is nothing to add.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub extension: Option<HelloExtension>,
}

impl Hello {
    /// Returns the versions that the agent speaks.
    pub fn versions(&self) -> VersionRange {
        let HelloExtension { newest, since } = self.extension.unwrap_or_default();
        VersionRange { oldest: self.protocol, newest, since }
    }
}

/// Named values at the end of a hello. A reader ignores names that it does not know.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default)]
pub struct HelloExtension {
    /// Newest version of the event stream that the agent speaks; `None` is the oldest.
    pub newest: Option<u16>,
    /// First release that speaks the oldest version.
    pub since: Option<Release>,
}

impl HelloExtension {
    /// Returns what the hello of an agent that speaks these versions adds.
    pub fn of(versions: &VersionRange) -> Option<Self> {
        // PEERNet 0.1.0 cannot read a hello with an extension. It is left out where there is nothing that 0.1.0 misses.
        let is_first = (versions.oldest(), versions.newest()) == (FIRST_VERSION, FIRST_VERSION);
        (!is_first).then_some(Self { newest: versions.newest, since: versions.since })
    }
}

impl Serialize for HelloExtension {
    /// Writes a map, where other structures of the event stream are arrays.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(2))?;
        map.serialize_entry("newest", &self.newest)?;
        map.serialize_entry("since", &self.since)?;
        map.end()
    }
}
