//! Times and the types of `std_msgs`.

use super::field::struct_field;
use super::{DecodeError, EncodeError, Field, Message, MessageDefinition, Reader, WireForm, Writer};

/// An instant: `time` in ROS 1, `builtin_interfaces/Time` in ROS 2.
///
/// The publisher chooses the clock. ROS does not define which clock that is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Time {
    /// Seconds since the clock's epoch. The range is 0 to 2³² − 1 in ROS 1 and −2³¹ to 2³¹ − 1 in ROS 2.
    pub sec: i64,
    /// Nanoseconds after `sec`.
    pub nanosec: u32,
}

impl Time {
    /// Returns the instant with this number of nanoseconds since the epoch.
    pub fn from_nanos(nanos: i64) -> Self {
        let nanosec = u32::try_from(nanos.rem_euclid(1_000_000_000)).unwrap_or_default();
        Self { sec: nanos.div_euclid(1_000_000_000), nanosec }
    }

    /// Returns the nanoseconds since the epoch, saturating at the range of 64 bits.
    pub fn as_nanos(self) -> i64 {
        self.sec.saturating_mul(1_000_000_000).saturating_add(i64::from(self.nanosec))
    }
}

impl Field for Time {
    const MIN_BYTES: usize = 8;

    fn write(&self, writer: &mut Writer) -> Result<(), EncodeError> {
        let error = |_| EncodeError::TimeOutOfRange { seconds: self.sec };
        match writer.form() {
            WireForm::Ros1 => u32::try_from(self.sec).map_err(error)?.write(writer)?,
            WireForm::Cdr => i32::try_from(self.sec).map_err(error)?.write(writer)?,
        }
        self.nanosec.write(writer)
    }

    fn read(reader: &mut Reader) -> Result<Self, DecodeError> {
        let sec = match reader.form() {
            WireForm::Ros1 => u32::read(reader)?.into(),
            WireForm::Cdr => i32::read(reader)?.into(),
        };
        Ok(Self { sec, nanosec: u32::read(reader)? })
    }
}

/// `std_msgs/Header`: capture time and coordinate frame of the data of a message.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// Number of the message in ROS 1; 0 in a decoded message of ROS 2.
    pub seq: u32,
    /// Capture time.
    pub stamp: Time,
    /// Coordinate frame.
    pub frame_id: String,
}

impl Header {
    pub(super) const DEFINITION: MessageDefinition = MessageDefinition {
        name: "std_msgs/Header",
        md5: "2176decaecbce78abc3b96ef049fabed",
        text: "uint32 seq\ntime stamp\nstring frame_id\n",
        dependencies: &[],
    };
}

impl Field for Header {
    // `seq` is not included, because ROS 2 does not have it.
    const MIN_BYTES: usize = Time::MIN_BYTES + String::MIN_BYTES;

    fn write(&self, writer: &mut Writer) -> Result<(), EncodeError> {
        if writer.form() == WireForm::Ros1 {
            self.seq.write(writer)?;
        }
        self.stamp.write(writer)?;
        self.frame_id.write(writer)
    }

    fn read(reader: &mut Reader) -> Result<Self, DecodeError> {
        let seq = if reader.form() == WireForm::Ros1 { u32::read(reader)? } else { 0 };
        Ok(Self { seq, stamp: Time::read(reader)?, frame_id: String::read(reader)? })
    }
}

impl Message for Header {
    const DEFINITION: &'static MessageDefinition = &Self::DEFINITION;
    const DDS_TYPE: &'static str = "std_msgs::msg::dds_::Header_";
}

/// `std_msgs/String`: a text.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StringMessage {
    /// The text.
    pub data: String,
}

struct_field!(StringMessage { data: String });

impl Message for StringMessage {
    const DEFINITION: &'static MessageDefinition = &MessageDefinition {
        name: "std_msgs/String",
        md5: "992ce8a1687cec8c8bd883ec73ca41d1",
        text: "string data\n",
        dependencies: &[],
    };
    const DDS_TYPE: &'static str = "std_msgs::msg::dds_::String_";
}
