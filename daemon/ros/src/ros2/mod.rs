//! ROS 2: topics over DDS.
