//! Peers by their names in the published file of devices.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use peernet_networks::Address;
use peernet_report::record::NetworkConfig;
use toml::{Table, Value};

use super::experiment::Network;
use crate::published::addresses;
use crate::run::origin::origin;

/// Files of devices, each read once: what is remarked of one is said once, however many combinations there are.
#[derive(Default)]
pub(super) struct Files(BTreeMap<PathBuf, Result<Devices, String>>);

/// The addresses of the devices, and the file.
type Devices = (BTreeMap<String, Address>, NetworkConfig);

impl Files {
    fn read(&mut self, path: &Path) -> Result<&Devices, String> {
        let read = || {
            addresses(path).map_err(|failure| match path.is_relative() && !path.exists() {
                true => format!("network.config: {failure}; {}", origin()),
                false => format!("network.config: {failure}"),
            })
        };
        self.0.entry(path.to_owned()).or_insert_with(read).as_ref().map_err(Clone::clone)
    }
}

/// Puts the address in the place of a device's name in `pipeline.placement.peer`, and returns the file that has it.
///
/// # Errors
/// A sentence with its key, when there is no such device.
pub(super) fn resolve(
    pipeline: &mut Table,
    network: Option<&Network>,
    files: &mut Files,
) -> Result<Option<NetworkConfig>, String> {
    let placement = pipeline.get_mut("placement").and_then(Value::as_table_mut);
    let Some(Value::String(peer)) = placement.and_then(|placement| placement.get_mut("peer")) else {
        return Ok(None);
    };
    if peer.contains("://") {
        return Ok(None);
    }
    let Some(network) = network else {
        return Err(format!(
            "pipeline.placement.peer: {peer:?} is no address; write tcp://host:5551, or name the file of the devices: [network] config = \"net_config.yaml\""
        ));
    };
    let (devices, file) = files.read(&network.config)?;
    let address = devices.get(peer.as_str()).ok_or_else(|| {
        let known: Vec<&str> = devices.keys().map(String::as_str).collect();
        format!(
            "pipeline.placement.peer: {} has no device {peer}; there is {}",
            network.config.display(),
            known.join(", ")
        )
    })?;
    *peer = address.to_string();
    Ok(Some(file.clone()))
}
