//! The cloud's address where only its name is known.

use peernet_ros::ros1::Environment;
use peernet_ros::topics::{RosVersion, VersionError};

use super::names::allowed;
use crate::transport::UnknownAddress;

/// Returns the address of the cloud with a name. The version is the one given, or else that of the environment; the master
/// is that of `ROS_MASTER_URI`.
pub(super) fn find(name: &str, version: Option<u64>) -> Result<String, UnknownAddress> {
    check_version(version, |name| std::env::var(name).ok())?;
    let environment = Environment::from_process().map_err(|error| UnknownAddress(error.to_string()))?;
    let master = environment.master;
    let host =
        if master.host().contains(':') { format!("[{}]", master.host()) } else { master.host().to_owned() };
    Ok(format!("ros1://{host}:{}/{}", master.port(), allowed(name)))
}

fn check_version(
    given: Option<u64>,
    variable: impl Fn(&str) -> Option<String>,
) -> Result<(), UnknownAddress> {
    let unknown = |error: VersionError| UnknownAddress(format!("ros_version: {error}"));
    // A number that no byte holds is no version either.
    let given = given.map(|number| RosVersion::try_from(u8::try_from(number).unwrap_or(u8::MAX)));
    match RosVersion::resolve(given.transpose().map_err(unknown)?, variable) {
        // Where nothing says which, it is the one that this network speaks.
        Ok(RosVersion::Ros1) | Err(VersionError::NotGiven) => Ok(()),
        Ok(RosVersion::Ros2) => Err(UnknownAddress(
            "the network ros speaks ROS 1, but ROS 2 is asked for; write ros_version: 1 into the network configuration and \
             start a master (roscore), or use another network"
                .to_owned(),
        )),
        Err(error) => Err(UnknownAddress(error.to_string())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_version_is_refused_with_next_step() {
        let check = |given, distribution: Option<&str>| {
            check_version(given, |name| distribution.filter(|_| name == "ROS_DISTRO").map(str::to_owned))
        };
        for asked in [check(Some(2), None), check(None, Some("jazzy"))] {
            let error = asked.expect_err("not spoken").to_string();
            assert!(error.contains("ROS 2") && error.contains("ros_version: 1"), "{error}");
        }
        assert!(check(Some(300), None).is_err());
        for accepted in [check(Some(1), Some("jazzy")), check(None, Some("noetic")), check(None, None)] {
            assert!(accepted.is_ok());
        }
    }

    #[test]
    fn address_has_the_name_as_ros_allows_it() {
        let address = find("jetson-orin", Some(1)).expect("ROS 1");
        assert!(address.starts_with("ros1://") && address.ends_with("/jetson_orin"), "{address}");
    }
}
