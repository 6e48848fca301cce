//! Message types of ROS, and how they are written in ROS 1 and in ROS 2.
