//! Checks that the build and this host support ROS 2.

use std::error::Error;

use peernet_ros::ros2::{self, Ros2Error, check_interfaces};

use crate::transport::HostChecks;
use crate::{Address, SessionSettings};

/// The checks of this network.
pub(crate) const HOST_CHECKS: HostChecks = HostChecks { check_address, check_settings };

fn check_address(address: &Address) -> Result<(), Box<dyn Error + Send + Sync>> {
    // Only addresses of ROS 2 have a domain.
    if address.ros_domain().is_some() && !ros2::IS_BUILT { Err(Ros2Error::NotBuilt.into()) } else { Ok(()) }
}

fn check_settings(settings: &SessionSettings) -> Result<(), (&'static str, Box<dyn Error + Send + Sync>)> {
    check_interfaces(&settings.ros2.interfaces).map_err(|error| ("ros2.interfaces", error.into()))
}

#[cfg(test)]
mod tests {
    use crate::{Address, NetworkKind, Ros2SessionSettings, SessionSettings};

    #[test]
    fn domain_address_requires_ros2() {
        let checked = |text: &str| text.parse::<Address>().expect("an address").check_usable_on_this_host();
        assert!(checked("ros1://robot").is_ok());
        assert_eq!(checked("ros2://7").is_ok(), peernet_ros::ros2::IS_BUILT);
        if let Err(error) = checked("ros2://7") {
            let text = error.to_string();
            assert!(text.starts_with("ros2://7/peernet: ") && text.contains("cargo feature"), "{text}");
        }
    }

    #[test]
    fn unknown_interface_is_reported_with_its_key() {
        let interfaces = vec!["eth99".to_owned()];
        let settings = SessionSettings {
            ros2: Ros2SessionSettings { interfaces, ..Ros2SessionSettings::default() },
            ..SessionSettings::default()
        };
        assert!(NetworkKind::Ros.check_settings(&SessionSettings::default()).is_ok());
        let error = NetworkKind::Ros.check_settings(&settings).expect_err("this host has no such interface");
        assert_eq!(error.key, "ros2.interfaces");
        assert!(error.to_string().contains("\"eth99\""), "{error}");
        assert!(NetworkKind::ZmqTcp.check_settings(&settings).is_ok());
    }
}
