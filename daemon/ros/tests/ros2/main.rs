//! Nodes of ROS 2 in one process, over DDS on loopback.

mod topics;
