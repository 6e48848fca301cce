//! The table `[serve]`.

use std::net::{IpAddr, Ipv4Addr};

use peernet_networks::{Address, NetworkKind, SessionSettings};
use serde::{Deserialize, Serialize};

use super::ListenAddresses;

/// `[serve]`: addresses at which this host serves its models to peers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ServeConfig {
    /// Address to listen on, or a list of addresses; the scheme of each selects its network. `tcp://0.0.0.0:5551`
    /// accepts peers on every interface. Default: `tcp://127.0.0.1:5551`, which accepts peers of this machine only.
    pub listen: ListenAddresses,
    /// Kind of network, which must match every address in `listen`. Default: the kind that each address selects.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub network: Option<NetworkKind>,
    /// `true` if peers may use the built-in echo model `calibration`, which `peernet calibrate` needs. Default: true.
    pub calibration: bool,
    /// Time limits and bounds of each session. Bounds on all sessions together, such as `max_sessions`, apply
    /// separately to each address.
    pub session: SessionSettings,
}

impl Default for ServeConfig {
    fn default() -> Self {
        Self {
            listen: Address::from_ip(IpAddr::V4(Ipv4Addr::LOCALHOST), 5551).into(),
            network: None,
            calibration: true,
            session: SessionSettings::default(),
        }
    }
}
