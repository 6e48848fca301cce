//! Tests of ROS 2 nodes in one process, over DDS on loopback.

mod topics;
