//! Any bytes on a connection of a ROS 1 topic.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| peernet_ros::fuzzing::any_connection(data));
