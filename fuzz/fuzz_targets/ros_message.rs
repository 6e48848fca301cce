//! Any bytes as a message of a ROS topic.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| peernet_ros::fuzzing::any_message(data));
