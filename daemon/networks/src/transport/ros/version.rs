//! Which version of ROS is meant where no address says it.

use peernet_ros::ros1::Environment;

use super::names::allowed;
use crate::transport::UnknownAddress;

/// Distributions of ROS 1 that were still in use in 2025.
const ROS_1_DISTRIBUTIONS: [&str; 6] = ["noetic", "melodic", "lunar", "kinetic", "jade", "indigo"];

/// Returns the address of the cloud with a name. The version is the one given, or else that of `ROS_VERSION`, or of
/// `ROS_DISTRO`; the master is that of `ROS_MASTER_URI`.
pub(super) fn find(name: &str, version: Option<u64>) -> Result<String, UnknownAddress> {
    let variable = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
    let (version, said_by) = chosen(version, variable);
    if version != 1 {
        return Err(UnknownAddress(format!(
            "the network ros speaks ROS 1, but {said_by} asks for ROS {version}; write ros_version: 1 into the network \
             configuration and start a master (roscore), or use another network"
        )));
    }
    let environment = Environment::from_process().map_err(|error| UnknownAddress(error.to_string()))?;
    let master = environment.master;
    let host =
        if master.host().contains(':') { format!("[{}]", master.host()) } else { master.host().to_owned() };
    Ok(format!("ros1://{host}:{}/{}", master.port(), allowed(name)))
}

/// The version, and what says so.
fn chosen(given: Option<u64>, variable: impl Fn(&str) -> Option<String>) -> (u64, &'static str) {
    if let Some(version) = given {
        return (version, "ros_version");
    }
    if let Some(version) = variable("ROS_VERSION").and_then(|text| text.trim().parse().ok()) {
        return (version, "ROS_VERSION");
    }
    match variable("ROS_DISTRO") {
        Some(distribution) if !ROS_1_DISTRIBUTIONS.contains(&distribution.trim()) => (2, "ROS_DISTRO"),
        _ => (1, "ROS_DISTRO"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn version_is_that_of_first_source_that_has_one() {
        let of = |given, variables: &[(&str, &str)]| {
            let value = |name: &str| variables.iter().find(|(known, _)| *known == name);
            chosen(given, |name| value(name).map(|(_, value)| (*value).to_owned()))
        };
        assert_eq!(of(Some(1), &[("ROS_VERSION", "2")]), (1, "ros_version"));
        assert_eq!(of(None, &[("ROS_VERSION", "2"), ("ROS_DISTRO", "noetic")]), (2, "ROS_VERSION"));
        assert_eq!(of(None, &[("ROS_DISTRO", "noetic")]).0, 1);
        assert_eq!(of(None, &[("ROS_DISTRO", "jazzy")]).0, 2);
        assert_eq!(of(None, &[]).0, 1);
    }

    #[test]
    fn other_version_is_refused_with_next_step() {
        let error = find("cloud", Some(2)).expect_err("not there").to_string();
        assert!(error.contains("ROS 2") && error.contains("ros_version: 1"), "{error}");
        let address = find("jetson-orin", Some(1)).expect("ROS 1");
        assert!(address.starts_with("ros1://") && address.ends_with("/jetson_orin"), "{address}");
    }
}
