//! Payload messages: standard types of ROS, which ROS tools can display.

use bytes::Bytes;
use peernet_ros::messages::{
    CompressedImage, DecodeError, EncodeError, EncodedMessage, Header, Image, Message, MultiArrayDimension,
    MultiArrayLayout, Time, UInt8MultiArray, WireForm,
};
use peernet_ros::ros1::TopicType;
use peernet_sample::{Description, MediaType, PixelFormat};

/// Type of the messages of a payload topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PayloadType {
    Image,
    CompressedImage,
    Bytes,
}

/// Error: a payload message cannot be read.
#[derive(Debug, thiserror::Error)]
pub(super) enum PayloadError {
    #[error("its type {0} cannot carry payloads of sessions")]
    OtherType(String),
    #[error(transparent)]
    Decode(#[from] DecodeError),
    #[error("the label of its first dimension does not name its connection and stamp")]
    NoStamp,
}

impl PayloadType {
    const ALL: [Self; 3] = [Self::Image, Self::CompressedImage, Self::Bytes];

    /// Returns the type for a part of a sample.
    pub(super) fn from_part(part: &Description, length: usize) -> Self {
        match part.media {
            MediaType::Jpeg | MediaType::Png => Self::CompressedImage,
            // Only a shape of rows, columns and channels that matches the length can be an `Image`.
            MediaType::Pixels(_) if part.shape.len() == 3 && part.shaped_bytes() == Some(length as u64) => {
                Self::Image
            }
            _ => Self::Bytes,
        }
    }

    pub(super) fn topic_type(self) -> TopicType {
        match self {
            Self::Image => TopicType::from_message::<Image>(),
            Self::CompressedImage => TopicType::from_message::<CompressedImage>(),
            Self::Bytes => TopicType::from_message::<UInt8MultiArray>(),
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Image => Image::DEFINITION.name,
            Self::CompressedImage => CompressedImage::DEFINITION.name,
            Self::Bytes => UInt8MultiArray::DEFINITION.name,
        }
    }
}

/// Encodes a payload message with the header of its companion.
pub(super) fn encode(
    form: WireForm,
    header: &Header,
    part: &Description,
    data: &Bytes,
) -> Result<EncodedMessage, EncodeError> {
    let (header, data) = (header.clone(), data.clone());
    match PayloadType::from_part(part, data.len()) {
        PayloadType::CompressedImage => {
            let format = if part.media == MediaType::Png { "png" } else { "jpeg" }.to_owned();
            CompressedImage { header, format, data }.encode(form)
        }
        PayloadType::Image => {
            let (height, width, channels) = (part.shape[0], part.shape[1], part.shape[2]);
            let encoding = match part.media {
                MediaType::Pixels(PixelFormat::Grey8) => "mono8",
                _ => "rgb8",
            };
            let (encoding, step) = (encoding.to_owned(), width.saturating_mul(channels));
            Image { header, height, width, encoding, is_bigendian: 0, step, data }.encode(form)
        }
        PayloadType::Bytes => {
            let size = u32::try_from(data.len()).map_err(|_| EncodeError::TooLong { length: data.len() })?;
            // This type has no header, so the label carries the connection and the stamp.
            let label = format!("{} {}", header.frame_id, header.stamp.as_nanos());
            let dim = vec![MultiArrayDimension { label, size, stride: size }];
            UInt8MultiArray { layout: MultiArrayLayout { dim, data_offset: 0 }, data }.encode(form)
        }
    }
}

/// Decodes a payload message of a type. Returns the identifier of the connection, the stamp of the payload's companion
/// (`mod.rs`), and the payload.
pub(super) fn decode(
    form: WireForm,
    type_name: &str,
    message: Bytes,
) -> Result<(String, i64, Bytes), PayloadError> {
    let payload_type = PayloadType::ALL.into_iter().find(|candidate| candidate.name() == type_name);
    let with_connection_and_stamp = |header: Header, data| (header.frame_id, header.stamp.as_nanos(), data);
    match payload_type.ok_or_else(|| PayloadError::OtherType(type_name.to_owned()))? {
        PayloadType::Image => {
            let image = Image::decode(form, message)?;
            Ok(with_connection_and_stamp(image.header, image.data))
        }
        PayloadType::CompressedImage => {
            let image = CompressedImage::decode(form, message)?;
            Ok(with_connection_and_stamp(image.header, image.data))
        }
        PayloadType::Bytes => {
            let array = UInt8MultiArray::decode(form, message)?;
            let label = array.layout.dim.first().and_then(|dimension| dimension.label.split_once(' '));
            let (connection, stamp) = label.ok_or(PayloadError::NoStamp)?;
            let stamp: i64 = stamp.parse().map_err(|_| PayloadError::NoStamp)?;
            // The stamp is converted as the stamp of a header is, so that a payload and its companion have the same
            // stamp.
            Ok((connection.to_owned(), Time::from_nanos(stamp).as_nanos(), array.data))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn payloads_are_read_as_written_in_standard_types() {
        let jpeg = Description::unshaped(MediaType::Jpeg);
        let cases = [
            (jpeg, 30, "sensor_msgs/CompressedImage"),
            (Description::pixels(PixelFormat::Rgb8, 5, 2), 30, "sensor_msgs/Image"),
            (Description::pixels(PixelFormat::Grey8, 15, 2), 30, "sensor_msgs/Image"),
            (Description::pixels(PixelFormat::Rgb8, 5, 2), 29, "std_msgs/UInt8MultiArray"),
            (Description::bytes(), 0, "std_msgs/UInt8MultiArray"),
        ];
        for (part, length, name) in cases {
            let data = Bytes::from(vec![7; length]);
            let header = Header { seq: 3, stamp: Time::from_nanos(5_000_000_007), frame_id: "ab".into() };
            let kind = PayloadType::from_part(&part, length);
            assert_eq!((&*kind.topic_type().name, kind.name()), (name, name));
            for form in [WireForm::Ros1, WireForm::Cdr] {
                let message = encode(form, &header, &part, &data).expect("can be written");
                let read = decode(form, name, message.into_bytes()).expect("can be read");
                assert_eq!(read, ("ab".to_owned(), 5_000_000_007, data.clone()));
            }
        }
    }

    #[test]
    fn messages_without_stamp_or_of_other_type_are_invalid() {
        let array = |label: &str| {
            let dim = vec![MultiArrayDimension { label: label.into(), size: 0, stride: 0 }];
            let layout = MultiArrayLayout { dim, data_offset: 0 };
            let message = UInt8MultiArray { layout, data: Bytes::new() }
                .encode(WireForm::Ros1)
                .expect("can be written");
            decode(WireForm::Ros1, "std_msgs/UInt8MultiArray", message.into_bytes())
        };
        assert!(matches!(array("rows"), Err(PayloadError::NoStamp)));
        assert!(matches!(array("a x"), Err(PayloadError::NoStamp)));
        let other = decode(WireForm::Ros1, "std_msgs/String", Bytes::new());
        assert!(matches!(other, Err(PayloadError::OtherType(_))));
    }
}
