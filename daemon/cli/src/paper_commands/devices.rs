//! The network configuration: addresses of the devices, and which one serves.

use std::collections::BTreeMap;
use std::path::Path;

use crate::exit::{Exit, Failure};
use crate::output::print_to_stderr;
use crate::small_file;
use anyhow::{Context, anyhow};
use peernet_analysis::record::NetworkConfig;
use peernet_logger::Slug;
use peernet_networks::{Address, ListenerLookupError, NetworkKind, Ros2SessionSettings};
use serde::Deserialize;
use serde::de::IgnoredAny;

use crate::address::{AddressError, DEFAULT_PORT, address};

/// The file in the form that the paper's program reads.
#[derive(Debug, Deserialize)]
struct File {
    devices: BTreeMap<String, String>,
    server: Option<String>,
    start_port: Option<u16>,
    /// Version of ROS, 1 or 2, for the network `ros`.
    ros_version: Option<u64>,
    /// QoS and interfaces of the topics of ROS 2.
    #[serde(default)]
    ros2: Ros2SessionSettings,
    #[serde(flatten)]
    other: BTreeMap<String, IgnoredAny>,
}

/// A device without a usable address.
#[derive(Debug, thiserror::Error)]
enum DeviceError {
    #[error("{text:?} is no address of the device {name}: {source}")]
    Address { text: String, name: String, source: AddressError },
    #[error("no address of the device {name}: {source}")]
    Unknown { name: String, source: ListenerLookupError },
    #[error("the device {0} has port 0, to which no client can connect: set start_port to a number above 0")]
    PortZero(String),
}

impl File {
    fn read(text: &str, file: &str) -> anyhow::Result<Self> {
        let parsed: Self = serde_saphyr::from_str(text).map_err(|error| anyhow!("{file}: {error}"))?;
        if !parsed.other.is_empty() {
            let keys: Vec<&str> = parsed.other.keys().map(String::as_str).collect();
            print_to_stderr(format_args!(
                "{file}: ignored unknown keys: {}; known are devices, server, start_port, ros_version and ros2",
                keys.join(", ")
            ));
        }
        Ok(parsed)
    }

    /// Returns the address of the device `name`. `text` is the value of the device in the file. A host name without a
    /// scheme is on `network`.
    fn address(&self, name: &str, text: &str, network: NetworkKind) -> Result<Address, DeviceError> {
        // On a network that finds listeners by name, a host alone is no address, so the listener is looked up by the
        // name of the device.
        let listener =
            if text.contains("://") { None } else { network.find_listener(name, self.ros_version) };
        if let Some(listener) = listener {
            return listener.map_err(|source| DeviceError::Unknown { name: name.to_owned(), source });
        }
        let address = address(text, self.start_port.unwrap_or(DEFAULT_PORT), network);
        let invalid = |source| DeviceError::Address { text: text.to_owned(), name: name.to_owned(), source };
        let address = address.map_err(invalid)?;
        if address.port() == 0 && address.ros_domain().is_none() {
            return Err(DeviceError::PortZero(name.to_owned()));
        }
        Ok(address)
    }
}

/// Addresses of all devices in a network configuration.
#[derive(Debug)]
pub(crate) struct DeviceAddresses {
    /// Address of each device.
    pub(crate) addresses: BTreeMap<String, Address>,
    /// QoS and interfaces of the topics of ROS 2.
    pub(crate) ros2: Ros2SessionSettings,
    /// Path and text of the file.
    pub(crate) config: NetworkConfig,
}

/// Reads the addresses of all devices. Addresses without a scheme are on `network`.
///
/// # Errors
/// When the file cannot be read (exit code 66) or is incomplete or invalid (exit code 78).
pub(crate) fn addresses(path: &Path, network: NetworkKind) -> Result<DeviceAddresses, Failure> {
    let (path_text, text) = (path.display().to_string(), read_text(path)?);
    let invalid = |error: anyhow::Error| Failure::new(Exit::Configuration, error);
    let file = File::read(&text, &path_text).map_err(invalid)?;
    let addresses =
        file.devices.iter().map(|(name, text)| Ok((name.clone(), file.address(name, text, network)?)));
    let addresses = addresses.collect::<Result<_, DeviceError>>();
    let addresses = addresses.map_err(|problem| invalid(anyhow!("{path_text}: {problem}")))?;
    Ok(DeviceAddresses { addresses, ros2: file.ros2, config: NetworkConfig { file: path_text, text } })
}

fn read_text(path: &Path) -> Result<String, Failure> {
    small_file::read(path, small_file::MAX_BYTES)
        .with_context(|| format!("cannot read the network configuration {}", path.display()))
        .map_err(|error| Failure::new(Exit::NoInput, error))
}

/// Devices of a network configuration, and the server.
#[derive(Debug)]
pub(super) struct Devices {
    /// Name of the device that serves.
    pub(super) server: String,
    /// Address of the server.
    pub(super) server_address: Address,
    /// Path and text of the file.
    pub(super) config: NetworkConfig,
    /// QoS and interfaces of the topics of ROS 2.
    pub(super) ros2: Ros2SessionSettings,
    device_names: Vec<String>,
}

impl Devices {
    /// Reads the file. If a network is given, it must be the network of the server's address.
    ///
    /// # Errors
    /// When it cannot be read (exit code 66), is incomplete or invalid (exit code 78), or has the server on another
    /// network (exit code 78).
    pub(super) fn read(path: &Path, network: Option<NetworkKind>) -> Result<Self, Failure> {
        let file = path.display().to_string();
        let text = read_text(path)?;
        Self::parse(&text, &file, network).map_err(|error| Failure::new(Exit::Configuration, error))
    }

    fn parse(text: &str, file: &str, network: Option<NetworkKind>) -> anyhow::Result<Self> {
        let parsed = File::read(text, file)?;
        let device_names: Vec<String> = parsed.devices.keys().cloned().collect();
        let server = parsed.server.clone().ok_or_else(|| {
            anyhow!("{file} names no server; add the line `server: DEVICE` with the name of a device")
        })?;
        let address_text = parsed.devices.get(&server).ok_or_else(|| {
            anyhow!("{file}: the server {server} is not one of its devices: {}", list_devices(&device_names))
        })?;
        let server_address = parsed.address(&server, address_text, network.unwrap_or_default());
        let server_address = server_address.map_err(|problem| anyhow!("{file}: {problem}"))?;
        let network_check = server_address.check_network(network);
        network_check.map_err(|problem| anyhow!("--network does not agree with {file}: {problem}"))?;
        // The whole text is recorded with the results, because the file may change before a run is repeated.
        let config = NetworkConfig { file: file.to_owned(), text: text.to_owned() };
        Ok(Self { server, server_address, config, ros2: parsed.ros2, device_names })
    }

    /// Checks that this device may be started in this role.
    ///
    /// # Errors
    /// When it is not in the file, the file has the roles reversed, or this build lacks the network (exit code 78).
    pub(super) fn check(&self, name: &Slug, serves: bool) -> Result<(), Failure> {
        // Without this check, a wrong name or role would make the devices wait for each other without an error.
        let (file, server) = (&self.config.file, &self.server);
        let invalid = |text: String| Err(Failure::new(Exit::Configuration, anyhow!("{text}")));
        if !self.device_names.iter().any(|device| device == name.as_str()) {
            return invalid(format!(
                "{file} has no device {name}, only {}: use one of these names as --name, or add the device to the file",
                list_devices(&self.device_names)
            ));
        }
        // Only the server's address is used, so the file may also have addresses of networks that this build lacks.
        if let Err(problem) = self.server_address.check_usable_on_this_host() {
            return invalid(format!("{file}: the address of the server {server} cannot be used: {problem}"));
        }
        match (serves, server == name.as_str()) {
            (true, false) => invalid(format!(
                "{file} says that {server} serves, not {name}, so clients would connect to {server}; change the line server: of the file, or start this device with --client"
            )),
            (false, true) => invalid(format!(
                "{file} says that {name} serves: start it with --server, or change the line server:"
            )),
            _ => Ok(()),
        }
    }
}

fn list_devices(device_names: &[String]) -> String {
    if device_names.is_empty() { "no device at all".to_owned() } else { device_names.join(", ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn network_missing_in_build_is_reported() {
        let text = "devices: { edge: 127.0.0.1, cluster: 'ros2://0/cluster' }\nserver: cluster\n";
        let devices = Devices::parse(text, "net.yaml", None).expect("reads");
        let serves = true;
        let checked = devices.check(&"cluster".parse().expect("a name"), serves);
        match devices.server_address.check_usable_on_this_host() {
            Ok(()) => assert!(checked.is_ok(), "this build has ROS 2"),
            Err(_) => {
                let error = checked.expect_err("this build has no ROS 2").error.to_string();
                assert!(
                    error.starts_with("net.yaml: the address of the server cluster cannot be used: ros2://0/cluster: this build has no ROS 2"),
                    "{error}"
                );
                assert!(error.contains("build peernetd with the cargo feature"), "{error}");
            }
        }
    }

    const PUBLISHED: &str = "\
devices:
  jetson-orin: 192.168.1.20
  cluster: cluster.lab.example
server: cluster
";

    fn parse_error(text: &str) -> String {
        Devices::parse(text, "net.yaml", None).expect_err("something is wrong").to_string()
    }

    #[test]
    fn device_file_of_paper_is_parsed() {
        let devices = Devices::parse(PUBLISHED, "net.yaml", None).expect("reads");
        assert_eq!(devices.server_address.to_string(), "tcp://cluster.lab.example:5551");
        let text = format!("{PUBLISHED}start_port: 6000\nsomething: [1, 2]\n");
        let devices = Devices::parse(&text, "net.yaml", None).expect("reads");
        assert_eq!(devices.server_address.to_string(), "tcp://cluster.lab.example:6000");
    }

    #[test]
    fn named_listeners_have_names_of_devices() {
        let network = NetworkKind::ALL.iter().copied().find(|kind| kind.has_named_listeners());
        let text = format!("{PUBLISHED}ros_version: 1\n");
        let devices = Devices::parse(&text, "net.yaml", network).expect("reads");
        assert_eq!(devices.server_address.listener_name(), Some("cluster"));
        let text = text.replace("cluster.lab.example", "ros1://robot:7/gpu");
        let devices = Devices::parse(&text, "net.yaml", None).expect("reads");
        assert_eq!(devices.server_address.to_string(), "ros1://robot:7/gpu");
        let text =
            format!("{PUBLISHED}ros_version: 2\nros2:\n  reliability: best-effort\n  interfaces: [lo]\n");
        let devices = Devices::parse(&text, "net.yaml", network).expect("reads");
        assert!(devices.server_address.ros_domain().is_some());
        assert_eq!(devices.ros2.interfaces, ["lo"]);
        let text = text.replace("cluster.lab.example", "ros2://7/gpu");
        let devices = Devices::parse(&text, "net.yaml", None).expect("reads");
        assert_eq!(devices.server_address.to_string(), "ros2://7/gpu");
        let text = format!("{PUBLISHED}ros_version: 3\n");
        let error = Devices::parse(&text, "net.yaml", network).expect_err("no such version").to_string();
        assert!(error.contains("ros_version") && error.contains("cluster"), "{error}");
    }

    #[test]
    fn device_starts_only_in_its_role() {
        let devices = Devices::parse(PUBLISHED, "net.yaml", None).expect("reads");
        let check = |name: &str, serves| {
            let name = name.parse().expect("a name");
            devices.check(&name, serves).map_err(|failure| failure.to_string())
        };
        let check_server = |name| check(name, true);
        let check_client = |name| check(name, false);
        assert_eq!((check_server("cluster"), check_client("jetson-orin")), (Ok(()), Ok(())));
        let unknown = check_client("jetson").expect_err("not there");
        assert!(
            unknown.contains("no device jetson") && unknown.contains("cluster, jetson-orin"),
            "{unknown}"
        );
        assert!(check_server("jetson-orin").expect_err("a client").contains("cluster serves"));
        assert!(check_client("cluster").expect_err("a server").contains("--server"));
    }

    #[test]
    fn missing_keys_are_reported() {
        assert!(parse_error("devices: {a: 10.0.0.1}").contains("server:"));
        assert!(parse_error("devices: {a: 10.0.0.1}\nserver: b").contains("is not one of its devices: a"));
        assert!(parse_error("server: b").contains("devices"));
        assert!(parse_error("devices: {a: 'x y'}\nserver: a").contains("no address"));
        assert!(parse_error("devices: [").contains("net.yaml"));
    }
}
