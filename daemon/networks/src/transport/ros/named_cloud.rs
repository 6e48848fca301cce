//! The address of a cloud of which only the name is known.

use std::ffi::OsString;

use peernet_ros::ros1::Environment;
use peernet_ros::ros2::Ros2Settings;
use peernet_ros::topics::{RosVersion, VersionError};

use super::names::to_ros_name;
use crate::transport::ListenerLookupError;

/// Returns the address of the cloud with this name. `version` is the version of ROS; `None` takes the version from the
/// environment. In ROS 1 `ROS_MASTER_URI` names the master, in ROS 2 `ROS_DOMAIN_ID` the domain.
pub(super) fn find_address(name: &str, version: Option<u64>) -> Result<String, ListenerLookupError> {
    find_address_with(name, version, |name| std::env::var(name).ok())
}

fn find_address_with(
    name: &str,
    version: Option<u64>,
    variable: impl Fn(&str) -> Option<String>,
) -> Result<String, ListenerLookupError> {
    let name = to_ros_name(name);
    if requested_version(version, &variable)? == RosVersion::Ros2 {
        let settings = Ros2Settings::default().with_environment(variable);
        let settings = settings.map_err(|error| ListenerLookupError(error.to_string()))?;
        return Ok(format!("ros2://{}/{name}", settings.domain_id.unwrap_or_default()));
    }
    let environment = Environment::from_variables(|name| variable(name).map(OsString::from));
    let master = environment.map_err(|error| ListenerLookupError(error.to_string()))?.master;
    let host =
        // In a URI an IPv6 address has brackets (RFC 3986, section 3.2.2).
        if master.host().contains(':') { format!("[{}]", master.host()) } else { master.host().to_owned() };
    Ok(format!("ros1://{host}:{}/{name}", master.port()))
}

/// Returns the requested version; ROS 1 if neither the configuration nor the environment states a version.
fn requested_version(
    requested: Option<u64>,
    variable: impl Fn(&str) -> Option<String>,
) -> Result<RosVersion, ListenerLookupError> {
    // A number that does not fit into a byte is not a version.
    let requested = requested.map(|number| RosVersion::try_from(u8::try_from(number).unwrap_or(u8::MAX)));
    let requested =
        requested.transpose().map_err(|error| ListenerLookupError(format!("ros_version: {error}")))?;
    match RosVersion::resolve(requested, variable) {
        Err(VersionError::NotGiven) => Ok(RosVersion::Ros1),
        other => other.map_err(|error| ListenerLookupError(error.to_string())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(version: Option<u64>, variables: &[(&str, &str)]) -> Result<String, ListenerLookupError> {
        find_address_with("jetson-orin", version, |name| {
            variables.iter().find(|(key, _)| *key == name).map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn version_and_address_come_from_configuration_and_environment() {
        let (noetic, jazzy) = (("ROS_DISTRO", "noetic"), ("ROS_DISTRO", "jazzy"));
        let ros1 = Ok("ros1://localhost:11311/jetson_orin".to_owned());
        for (version, variables) in [(Some(1), &[jazzy][..]), (None, &[noetic]), (None, &[])] {
            assert_eq!(address(version, variables), ros1);
        }
        let master = ("ROS_MASTER_URI", "http://[::1]:7");
        assert_eq!(address(None, &[master]), Ok("ros1://[::1]:7/jetson_orin".to_owned()));
        let domain = ("ROS_DOMAIN_ID", "7");
        assert_eq!(address(Some(2), &[noetic]), Ok("ros2://0/jetson_orin".to_owned()));
        assert_eq!(address(None, &[("ROS_VERSION", "2"), domain]), Ok("ros2://7/jetson_orin".to_owned()));
        assert_eq!(address(None, &[jazzy, domain]), Ok("ros2://7/jetson_orin".to_owned()));
    }

    #[test]
    fn error_names_unusable_setting() {
        for number in [3, 300] {
            let error = address(Some(number), &[]).expect_err("no such version").to_string();
            assert!(error.contains("ros_version"), "{error}");
        }
        let error = address(Some(2), &[("ROS_DOMAIN_ID", "x")]).expect_err("no domain").to_string();
        assert!(error.contains("ROS_DOMAIN_ID"), "{error}");
    }
}
