//! The table `[probes]`.

use std::collections::BTreeMap;
use std::path::PathBuf;

use peernet_logger::Slug;
use serde::{Deserialize, Serialize};

use super::ReflectorAddress;

/// `[probes]`: small packets from which the relation of two hosts' clocks is estimated (STAMP, RFC 8762, over UDP).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ProbesConfig {
    /// `true` if peers' probes are answered; only a host with `[serve]` has peers that send probes. Default: true.
    pub reflect: bool,
    /// `true` if probes are sent to the peers of this host's pipelines. Default: true.
    pub send: bool,
    /// UDP port for probes, opened at each IP address of `[serve] listen`; peers get the port with their session. Ports
    /// below 1024, such as the standard's 862, need a capability, which the systemd unit grants. A configured port must
    /// be free; 0 selects any free port. Default: 8620, or any free port if 8620 is in use.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub port: Option<u16>,
    /// Probes per second while a link is in use; above 0 and at most 1000. Default: 10.
    pub rate_hz: f64,
    /// Probes per second while a link is idle; above 0 and at most `rate_hz`. Default: 1.
    pub idle_rate_hz: f64,
    /// File with the key of the authenticated mode: one line of at least 32 hexadecimal digits, readable by its owner
    /// only. Both ends need the same key. Default: none; probes are then authenticated by a key from the session.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub key_file: Option<PathBuf>,
    /// Bytes of padding added to each probe (RFC 8972, extra padding); at most 1300. Default: 0.
    pub padding_bytes: u16,
    /// Maximum number of answered probes per second for one address (in IPv6: for one /64 network); 1 to 10000. All
    /// addresses that have no session with this host share one limit, which is ten times as high. Default: 100.
    pub max_per_source_hz: u32,
    /// Additional STAMP reflectors of any vendor: `{ PEER = "udp://HOST:PORT" }`. The reflector is shown with the link
    /// to the peer whose name is `PEER`. Without a port, port 862 is used. No delay depends on the clocks of these
    /// reflectors. Default: none.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub reflectors: BTreeMap<Slug, ReflectorAddress>,
}

impl ProbesConfig {
    /// Port on which probes are answered if no port is configured and this port is free.
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
