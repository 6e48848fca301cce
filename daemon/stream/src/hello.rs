//! The hello: first message of an agent.

use peernet_logger::random_id;
use serde::ser::SerializeMap;
use serde::{Deserialize, Serialize, Serializer};

use crate::{ChainHash, HostDescription, Release, VersionRange};

/// Versions of the event stream that an aggregator of this release supports.
pub const STREAM_VERSIONS: VersionRange = VersionRange::new(5, 7, Release(0, 1, 0));

/// Versions that an agent of this release supports.
// An agent encodes events before it knows the version of its aggregator. The events may contain raw stamps, which
// version 7 added. An agent therefore supports no older version.
pub const AGENT_STREAM_VERSIONS: VersionRange = VersionRange::new(7, 7, Release(0, 3, 0));

/// The only version that PEERNet 0.1.0 supports.
const FIRST_VERSION: u16 = 5;

random_id! {
    /// Identifier of a stream of batches. The identifier is drawn at random when the agent's spool is created, so that
    /// the aggregator recognises a new spool.
    StreamId
}

/// First message of an agent, which describes its host and its stream.
///
/// The hello is sent before a version is chosen. Its form therefore never changes: fields of later versions are in the
/// extension.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// Oldest version of the event stream that the agent supports.
    pub protocol: u16,
    /// Description of the host.
    pub host: HostDescription,
    /// Stream that the batches belong to.
    pub stream: StreamId,
    /// Stream that the agent left and that this stream continues, if any. No batch is missing between the two streams.
    #[serde(rename = "previous")]
    pub previous_stream: Option<StreamId>,
    /// Number of the first batch that ever existed in the stream.
    pub first: u64,
    /// Number of the oldest batch that the agent still holds; the number after the newest batch if the agent holds
    /// none.
    pub oldest: u64,
    /// Chain hash of the batch before `oldest`.
    #[serde(rename = "before")]
    pub chain_before_oldest: ChainHash,
    /// Number of events in all batches of the spool before `oldest`. The aggregator computes from this number how many
    /// events are missing from its database.
    pub events_before_oldest: u64,
    /// Number of events in all batches of the spool before `first`, in earlier streams; `None` if it is unknown.
    pub events_before_first: Option<u64>,
    /// Configured length of a batch's body, bytes; a single larger event makes a longer batch. The window of
    /// batches in flight ([`ToAgent::Ack`](crate::ToAgent::Ack)) is counted in batches of this length.
    pub batch_bytes: u32,
    /// Random number of the process. It distinguishes a reconnect from a second process with a copied host id.
    pub process: u64,
    /// Fields that the hello of PEERNet 0.1.0 lacks; `None` if no such field is needed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub extension: Option<HelloExtension>,
}

impl Hello {
    /// Returns the versions that the agent supports.
    pub fn versions(&self) -> VersionRange {
        let HelloExtension { newest, since } = self.extension.unwrap_or_default();
        VersionRange { oldest: self.protocol, newest, since }
    }
}

/// Map at the end of a hello. A reader ignores unknown keys.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default)]
pub struct HelloExtension {
    /// Newest version of the event stream that the agent supports; `None` if it supports one version only.
    pub newest: Option<u16>,
    /// First release that supports the oldest version of the range.
    pub since: Option<Release>,
}

impl HelloExtension {
    /// Returns the extension for an agent that supports these versions; `None` if none is needed.
    pub fn from_versions(versions: &VersionRange) -> Option<Self> {
        // PEERNet 0.1.0 cannot read a hello with an extension. An agent that supports only version 5 therefore sends no
        // extension.
        let supports_first_version_only =
            (versions.oldest(), versions.newest()) == (FIRST_VERSION, FIRST_VERSION);
        (!supports_first_version_only).then_some(Self { newest: versions.newest, since: versions.since })
    }
}

impl Serialize for HelloExtension {
    /// Writes a map. The other structures of the event stream are arrays.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(2))?;
        map.serialize_entry("newest", &self.newest)?;
        map.serialize_entry("since", &self.since)?;
        map.end()
    }
}
