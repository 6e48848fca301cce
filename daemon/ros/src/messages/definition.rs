//! Definitions of message types in ROS 1.

use std::fmt::Write;

/// Type name, MD5 sum and text of a ROS 1 message type.
///
/// Peers compare the sums. `rosbag record` stores the text, so that others can read the bag without the package. The
/// sums are constants; a test computes them as genmsg does.
#[derive(Debug)]
pub struct MessageDefinition {
    /// Package and name, such as `sensor_msgs/Image`.
    pub name: &'static str,
    /// MD5 sum as genmsg computes it, in hexadecimal digits.
    pub md5: &'static str,
    /// Constants and fields, one a line, without comments.
    pub text: &'static str,
    /// Types that the text refers to, directly or indirectly, in the order of their first appearance.
    pub dependencies: &'static [&'static MessageDefinition],
}

impl MessageDefinition {
    /// Returns the text followed by the texts of the dependencies, in the form of connection headers and bags.
    pub fn full_text(&self) -> String {
        let mut full = self.text.to_owned();
        for dependency in self.dependencies {
            // genmsg writes this line between definitions, and readers of bags split the text there.
            let line = "=".repeat(80);
            // Writing to a String cannot fail.
            let _ = write!(full, "\n{line}\nMSG: {}\n{}", dependency.name, dependency.text);
        }
        full
    }
}
