//! Clients of ROS 1 and ROS 2 that need no ROS installation.
//!
//! `messages` has the message types and their two wire forms; `ros1` and `ros2` exchange messages as bytes. `topics` is
//! a blocking interface for callers that work with either version.

pub mod fuzzing;
pub mod messages;
pub mod ros1;
pub mod ros2;
pub mod topics;
