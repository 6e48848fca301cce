//! Types of `geometry_msgs` that messages of sensors contain.

use super::MessageDefinition;
use super::field::struct_field;

/// `geometry_msgs/Vector3`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vector3 {
    /// First component.
    pub x: f64,
    /// Second component.
    pub y: f64,
    /// Third component.
    pub z: f64,
}

struct_field!(Vector3 { x: f64, y: f64, z: f64 });

impl Vector3 {
    pub(super) const DEFINITION: MessageDefinition = MessageDefinition {
        name: "geometry_msgs/Vector3",
        md5: "4a842b65f413084dc2b10fb484ea7f17",
        text: "float64 x\nfloat64 y\nfloat64 z\n",
        dependencies: &[],
    };
}

/// `geometry_msgs/Quaternion`: an orientation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quaternion {
    /// First component of the vector part.
    pub x: f64,
    /// Second component of the vector part.
    pub y: f64,
    /// Third component of the vector part.
    pub z: f64,
    /// Scalar part.
    pub w: f64,
}

struct_field!(Quaternion { x: f64, y: f64, z: f64, w: f64 });

impl Quaternion {
    pub(super) const DEFINITION: MessageDefinition = MessageDefinition {
        name: "geometry_msgs/Quaternion",
        md5: "a779879fadf0160734f906b8c19c7004",
        text: "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
        dependencies: &[],
    };
}
