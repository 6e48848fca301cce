//! ROS 1: the master, and topics over TCP.
