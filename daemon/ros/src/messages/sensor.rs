//! Types of `sensor_msgs`.

use bytes::Bytes;

use super::field::struct_field;
use super::{Header, Message, MessageDefinition, Quaternion, Vector3};

/// `sensor_msgs/Image`: an uncompressed picture.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Image {
    /// Capture time and coordinate frame.
    pub header: Header,
    /// Number of rows.
    pub height: u32,
    /// Number of columns.
    pub width: u32,
    /// Order and size of the channels, such as `rgb8`.
    pub encoding: String,
    /// 1 if elements of several bytes are big-endian.
    pub is_bigendian: u8,
    /// Length of a row, bytes.
    pub step: u32,
    /// The rows, `step × height` bytes.
    pub data: Bytes,
}

struct_field!(Image {
    header: Header,
    height: u32,
    width: u32,
    encoding: String,
    is_bigendian: u8,
    step: u32,
    data: Bytes,
});

impl Message for Image {
    const DEFINITION: &'static MessageDefinition = &MessageDefinition {
        name: "sensor_msgs/Image",
        md5: "060021388200f6f0f447d0fcd9c64743",
        text: "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n\
               uint8[] data\n",
        dependencies: &[&Header::DEFINITION],
    };
    const DDS_TYPE: &'static str = "sensor_msgs::msg::dds_::Image_";
}

/// `sensor_msgs/CompressedImage`: a picture as the bytes of a file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CompressedImage {
    /// Capture time and coordinate frame.
    pub header: Header,
    /// Format, such as `jpeg` or `png`.
    pub format: String,
    /// Contents of the file.
    pub data: Bytes,
}

struct_field!(CompressedImage { header: Header, format: String, data: Bytes });

impl Message for CompressedImage {
    const DEFINITION: &'static MessageDefinition = &MessageDefinition {
        name: "sensor_msgs/CompressedImage",
        md5: "8f7a12909da2c9d3332d540a0977563f",
        text: "std_msgs/Header header\nstring format\nuint8[] data\n",
        dependencies: &[&Header::DEFINITION],
    };
    const DDS_TYPE: &'static str = "sensor_msgs::msg::dds_::CompressedImage_";
}

/// `sensor_msgs/Imu`: measurements of an inertial measurement unit. A covariance matrix is 3 × 3, row by row; −1 in its
/// first element means that the unit does not measure the quantity.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Imu {
    /// Capture time and coordinate frame.
    pub header: Header,
    /// Orientation.
    pub orientation: Quaternion,
    /// Covariance of the orientation about x, y and z.
    pub orientation_covariance: [f64; 9],
    /// Angular velocity in rad/s.
    pub angular_velocity: Vector3,
    /// Covariance of the angular velocity.
    pub angular_velocity_covariance: [f64; 9],
    /// Linear acceleration in m/s².
    pub linear_acceleration: Vector3,
    /// Covariance of the linear acceleration.
    pub linear_acceleration_covariance: [f64; 9],
}

struct_field!(Imu {
    header: Header,
    orientation: Quaternion,
    orientation_covariance: [f64; 9],
    angular_velocity: Vector3,
    angular_velocity_covariance: [f64; 9],
    linear_acceleration: Vector3,
    linear_acceleration_covariance: [f64; 9],
});

impl Message for Imu {
    const DEFINITION: &'static MessageDefinition = &MessageDefinition {
        name: "sensor_msgs/Imu",
        md5: "6a62c6daae103f4ff57a132d6f95cec2",
        text: "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n\
               geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n\
               geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n",
        dependencies: &[&Header::DEFINITION, &Quaternion::DEFINITION, &Vector3::DEFINITION],
    };
    const DDS_TYPE: &'static str = "sensor_msgs::msg::dds_::Imu_";
}

/// `sensor_msgs/PointField`: one value of each point of a cloud.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PointField {
    /// Name, such as `x`.
    pub name: String,
    /// Position of the value in the bytes of a point.
    pub offset: u32,
    /// Type of the value: 1 to 8 for int8, uint8, int16, uint16, int32, uint32, float32, float64.
    pub datatype: u8,
    /// Number of elements.
    pub count: u32,
}

struct_field!(PointField { name: String, offset: u32, datatype: u8, count: u32 });

impl PointField {
    pub(super) const DEFINITION: MessageDefinition = MessageDefinition {
        name: "sensor_msgs/PointField",
        md5: "268eacb2962780ceac86cbd17e328150",
        text: "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\nuint8 UINT32=6\nuint8 FLOAT32=7\n\
               uint8 FLOAT64=8\nstring name\nuint32 offset\nuint8 datatype\nuint32 count\n",
        dependencies: &[],
    };
}

/// `sensor_msgs/PointCloud2`: points in space.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PointCloud2 {
    /// Capture time and coordinate frame.
    pub header: Header,
    /// Number of rows; 1 for an unordered cloud.
    pub height: u32,
    /// Number of points in a row.
    pub width: u32,
    /// Values of each point.
    pub fields: Vec<PointField>,
    /// `true` if values are big-endian.
    pub is_bigendian: bool,
    /// Length of a point, bytes.
    pub point_step: u32,
    /// Length of a row, bytes.
    pub row_step: u32,
    /// The rows, `row_step × height` bytes.
    pub data: Bytes,
    /// `true` if all points are valid.
    pub is_dense: bool,
}

struct_field!(PointCloud2 {
    header: Header,
    height: u32,
    width: u32,
    fields: Vec<PointField>,
    is_bigendian: bool,
    point_step: u32,
    row_step: u32,
    data: Bytes,
    is_dense: bool,
});

impl Message for PointCloud2 {
    const DEFINITION: &'static MessageDefinition = &MessageDefinition {
        name: "sensor_msgs/PointCloud2",
        md5: "1158d486dd51d683ce2f1be655c3c181",
        text: "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n\
               uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n",
        dependencies: &[&Header::DEFINITION, &PointField::DEFINITION],
    };
    const DDS_TYPE: &'static str = "sensor_msgs::msg::dds_::PointCloud2_";
}
