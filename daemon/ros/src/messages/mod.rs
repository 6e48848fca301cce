//! Message types that ROS 1 and ROS 2 share, and their two wire forms.
//!
//! A [`Message`] is a plain struct. [`Message::encode`] and [`Message::decode`] convert it to and from the bytes of
//! either version. The bytes of pictures and point clouds are not copied: a decoded message refers to the received
//! bytes, and an encoded message refers to the bytes of the struct.

mod definition;
mod field;
mod geometry;
mod multi_array;
mod peernet;
mod reader;
mod sensor;
mod standard;
#[cfg(test)]
mod tests;
mod writer;

pub use definition::MessageDefinition;
pub use field::Field;
pub use geometry::{Quaternion, Vector3};
pub use multi_array::{MultiArrayDimension, MultiArrayLayout, UInt8MultiArray};
pub use peernet::{MessageInfo, SessionHello};
pub use reader::{DecodeError, Reader};
pub use sensor::{CompressedImage, Image, Imu, PointCloud2, PointField};
pub use standard::{Header, StringMessage, Time};
pub use writer::{EncodeError, EncodedMessage, Writer};

use bytes::Bytes;

/// Serialization of a version of ROS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WireForm {
    /// Serialization of ROS 1: little-endian, without alignment, texts without a final NUL, headers with `seq`.
    Ros1,
    /// Plain CDR of version 1 (XCDR1) with its encapsulation header, as ROS 2 uses it. Written little-endian, read in
    /// both byte orders.
    Cdr,
}

/// A message type that can be published as a topic of both versions of ROS.
pub trait Message: Field {
    /// Definition of the type in ROS 1.
    const DEFINITION: &'static MessageDefinition;

    /// Name of the type in DDS, such as `sensor_msgs::msg::dds_::Image_`.
    const DDS_TYPE: &'static str;

    /// Encodes the message.
    ///
    /// # Errors
    /// If the wire form cannot represent a value: [`EncodeError`].
    fn encode(&self, form: WireForm) -> Result<EncodedMessage, EncodeError> {
        let mut writer = Writer::new(form);
        self.write(&mut writer)?;
        Ok(writer.finish())
    }

    /// Decodes a message that fills `bytes`.
    ///
    /// # Errors
    /// If the bytes are not exactly one message of the type: [`DecodeError`].
    fn decode(form: WireForm, bytes: Bytes) -> Result<Self, DecodeError> {
        let mut reader = Reader::new(form, bytes)?;
        let message = Self::read(&mut reader)?;
        reader.finish()?;
        Ok(message)
    }
}
