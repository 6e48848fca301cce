//! Lookup of peers by their names in the network configuration of the paper.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use peernet_analysis::record::NetworkConfig;
use peernet_networks::{NetworkKind, Ros2SessionSettings};
use toml::{Table, Value};

use super::experiment::Network;
use crate::exit::Failure;
use crate::network::parse_network_kind;
use crate::paper_commands::{DeviceAddresses, addresses};
use crate::run::relative_paths::base_hint;

/// Addresses of devices by file and network. They are kept, so that remarks about a file do not
/// appear again for every combination.
#[derive(Default)]
pub(super) struct DeviceFiles(BTreeMap<(PathBuf, &'static str), Result<DeviceAddresses, Arc<Failure>>>);

/// A peer without a known address; the text begins with the key.
#[derive(Clone, Debug, thiserror::Error)]
pub(super) enum PeerError {
    #[error("network.config: {0}; {hint}", hint = base_hint())]
    MissingRelativeFile(Arc<Failure>),
    #[error("network.config: {0}")]
    File(Arc<Failure>),
    #[error(
        "pipeline.placement.peer: {0:?} is no address; write tcp://host:5551, or name the file of the devices: [network] config = \"net_config.yaml\""
    )]
    NotAnAddress(String),
    #[error("pipeline.placement.peer: {} has no device {peer}, only {}", .file.display(), .known.join(", "))]
    UnknownDevice { file: PathBuf, peer: String, known: Vec<String> },
    #[error("network.config: the settings ros2 cannot be used: {0}")]
    Ros2(#[source] toml::ser::Error),
}

impl DeviceFiles {
    fn read(&mut self, path: &Path, kind: NetworkKind) -> Result<&DeviceAddresses, PeerError> {
        // The address of a device depends on the network, so a file is read once for each network.
        let key = (path.to_owned(), kind.name());
        let addresses = self.0.entry(key).or_insert_with(|| addresses(path, kind).map_err(Arc::new));
        addresses.as_ref().map_err(|failure| {
            let failure = Arc::clone(failure);
            if path.is_relative() && !path.exists() {
                PeerError::MissingRelativeFile(failure)
            } else {
                PeerError::File(failure)
            }
        })
    }
}

/// Replaces a device's name in `pipeline.placement.peer` by its address, and for an address of
/// ROS 2 adds the file's settings to `pipeline.placement.session.ros2`. Returns the file that has
/// the device; `None` if the pipeline names no device.
///
/// # Errors
/// When no file is configured, or it cannot be read or has no such device.
pub(super) fn resolve(
    pipeline: &mut Table,
    network: Option<&Network>,
    files: &mut DeviceFiles,
) -> Result<Option<NetworkConfig>, PeerError> {
    let Some(placement) = pipeline.get_mut("placement").and_then(Value::as_table_mut) else {
        return Ok(None);
    };
    // An unknown network is reported when the whole pipeline is read.
    let kind =
        placement.get("network").and_then(Value::as_str).and_then(|name| parse_network_kind(name).ok());
    let Some(Value::String(peer)) = placement.get_mut("peer") else {
        return Ok(None);
    };
    if peer.contains("://") {
        return Ok(None);
    }
    let Some(network) = network else {
        return Err(PeerError::NotAnAddress(peer.clone()));
    };
    let DeviceAddresses { addresses, ros2, config } =
        files.read(&network.config, kind.unwrap_or_default())?;
    let address = addresses.get(peer.as_str()).ok_or_else(|| PeerError::UnknownDevice {
        file: network.config.clone(),
        peer: peer.clone(),
        known: addresses.keys().cloned().collect(),
    })?;
    *peer = address.to_string();
    if address.ros_domain().is_some() {
        add_ros2(placement, ros2).map_err(PeerError::Ros2)?;
    }
    Ok(Some(config.clone()))
}

/// Adds the settings of a file of devices to a placement. Keys of the placement take precedence.
fn add_ros2(placement: &mut Table, file_settings: &Ros2SessionSettings) -> Result<(), toml::ser::Error> {
    // Defaults are not written: plans of earlier releases do not contain them, and an experiment can only be continued
    // with an unchanged plan.
    if *file_settings == Ros2SessionSettings::default() {
        return Ok(());
    }
    let empty = || Value::Table(Table::new());
    let session = placement.entry("session").or_insert_with(empty).as_table_mut();
    let ros2 = session.and_then(|session| session.entry("ros2").or_insert_with(empty).as_table_mut());
    // A value that is not a table is reported when the whole pipeline is read.
    let Some(ros2) = ros2 else { return Ok(()) };
    for (key, value) in Table::try_from(file_settings)? {
        ros2.entry(key).or_insert(value);
    }
    Ok(())
}
