//! `[probes]`

use std::collections::BTreeMap;
use std::path::PathBuf;

use peernet_logger::Slug;
use serde::{Deserialize, Serialize};

use super::ReflectorAddress;

/// `[probes]`: small packets that relate two hosts' clocks (STAMP, RFC 8762, over UDP).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ProbesConfig {
    /// Whether peers' probes are answered; only a host with `[serve]` has peers that probe. Default: true.
    pub reflect: bool,
    /// Whether probes are sent to the peers of this host's pipelines. Default: true.
    pub send: bool,
    /// UDP port at each IP address of `[serve] listen` on which probes are answered; peers are told. Ports below 1024,
    /// such as the standard's 862, need a capability, which the systemd unit grants. A port given here must be
    /// free; 0 is any free one. Default: 8620, or any free one when that is taken.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub port: Option<u16>,
    /// Probes per second while a link is in use; above 0 and at most 1000. Default: 10.
    pub rate_hz: f64,
    /// Probes per second while it is not; above 0 and at most `rate_hz`. Default: 1.
    pub idle_rate_hz: f64,
    /// File with the key of the authenticated mode: one line of at least 32 hexadecimal digits, readable by its
    /// owner only. Both ends need the same. Default: unauthenticated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub key_file: Option<PathBuf>,
    /// Bytes added to each probe (RFC 8972, extra padding); at most 1300. Default: 0.
    pub padding_bytes: u16,
    /// Probes per second that are answered for one address (of IPv6: for one network of 64 bits); 1 to 10000. All addresses
    /// without a session on this host together get ten times as many. Default: 100.
    pub max_per_source_hz: u32,
    /// Reflectors of STAMP, of any make, that are probed beside those of the peers, by the name of the peer whose link shows them:
    /// `udp://HOST:PORT`, without a port at 862. Their clocks are not tied to the peer's: no delay rests on them. Default: none.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub reflectors: BTreeMap<Slug, ReflectorAddress>,
}

impl ProbesConfig {
    /// The port on which probes are answered, when it is free and no other is configured.
    pub const DEFAULT_PORT: u16 = 8620;
}

impl Default for ProbesConfig {
    fn default() -> Self {
        Self {
            reflect: true,
            send: true,
            port: None,
            rate_hz: 10.0,
            idle_rate_hz: 1.0,
            key_file: None,
            padding_bytes: 0,
            max_per_source_hz: 100,
            reflectors: BTreeMap::new(),
        }
    }
}
