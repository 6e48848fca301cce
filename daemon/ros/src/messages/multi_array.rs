//! Arrays of `std_msgs`.

use bytes::Bytes;

use super::field::struct_field;
use super::{Message, MessageDefinition};

/// `std_msgs/MultiArrayDimension`: one dimension of an array.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MultiArrayDimension {
    /// Meaning of the dimension.
    pub label: String,
    /// Number of elements.
    pub size: u32,
    /// Product of the sizes of this dimension and of all inner dimensions.
    pub stride: u32,
}

struct_field!(MultiArrayDimension { label: String, size: u32, stride: u32 });

impl MultiArrayDimension {
    const DEFINITION: MessageDefinition = MessageDefinition {
        name: "std_msgs/MultiArrayDimension",
        md5: "4cd0c83a8683deae40ecdac60e53bfa8",
        text: "string label\nuint32 size\nuint32 stride\n",
        dependencies: &[],
    };
}

/// `std_msgs/MultiArrayLayout`: the dimensions of an array.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MultiArrayLayout {
    /// Dimensions, outermost first.
    pub dim: Vec<MultiArrayDimension>,
    /// Number of padding elements before the array.
    pub data_offset: u32,
}

struct_field!(MultiArrayLayout { dim: Vec<MultiArrayDimension>, data_offset: u32 });

impl MultiArrayLayout {
    const DEFINITION: MessageDefinition = MessageDefinition {
        name: "std_msgs/MultiArrayLayout",
        md5: "0fed2a11c13e11c5571b4e2a995a91a3",
        text: "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset\n",
        dependencies: &[&MultiArrayDimension::DEFINITION],
    };
}

/// `std_msgs/UInt8MultiArray`: bytes with a layout.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct UInt8MultiArray {
    /// Dimensions of the array.
    pub layout: MultiArrayLayout,
    /// The bytes.
    pub data: Bytes,
}

struct_field!(UInt8MultiArray { layout: MultiArrayLayout, data: Bytes });

impl Message for UInt8MultiArray {
    const DEFINITION: &'static MessageDefinition = &MessageDefinition {
        name: "std_msgs/UInt8MultiArray",
        md5: "82373f1612381bb6ee473b5cd6f5d89c",
        text: "std_msgs/MultiArrayLayout layout\nuint8[] data\n",
        dependencies: &[&MultiArrayLayout::DEFINITION, &MultiArrayDimension::DEFINITION],
    };
    const DDS_TYPE: &'static str = "std_msgs::msg::dds_::UInt8MultiArray_";
}
