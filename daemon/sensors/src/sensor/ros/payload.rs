//! Conversion of a ROS message to the parts of a sample.

use peernet_clock::WallTime;
use peernet_ros::messages::{
    CompressedImage, DecodeError, Image, Imu, Message, PointCloud2, PointField, StringMessage, Time,
};
use peernet_ros::topics::TopicMessage;
use peernet_sample::{Description, ElementType, MediaType, Part};
use serde_json::json;

use super::image::{self, PictureError};

/// Parts of a sample, and its capture time.
#[derive(Debug)]
pub(super) struct Payload {
    pub(super) parts: Vec<Part>,
    /// The time `header.stamp`. `None` if this module does not decode the type, the type has no header, or the
    /// publisher set no time.
    pub(super) stamp: Option<WallTime>,
}

/// Reason why a message cannot be converted to a sample.
#[derive(Debug, thiserror::Error)]
pub(super) enum PayloadError {
    #[error(transparent)]
    Decode(#[from] DecodeError),
    #[error(transparent)]
    Picture(#[from] PictureError),
}

impl Payload {
    /// Converts a message according to the type that its publisher announces. A message of a type that this module does
    /// not decode becomes one part with its serialised bytes.
    pub(super) fn decode(message: &TopicMessage) -> Result<Self, PayloadError> {
        let type_name = &*message.type_name;
        if type_name == Image::DEFINITION.name {
            let image: Image = read(message)?;
            let stamp = stamp(image.header.stamp);
            return Ok(Self { parts: vec![image::picture_part(image)?], stamp });
        }
        if type_name == CompressedImage::DEFINITION.name {
            let image: CompressedImage = read(message)?;
            let part = Part {
                description: Description::unshaped(media_type_of_format(&image.format)),
                bytes: image.data,
            };
            return Ok(Self { parts: vec![part], stamp: stamp(image.header.stamp) });
        }
        if type_name == PointCloud2::DEFINITION.name {
            let cloud: PointCloud2 = read(message)?;
            let stamp = stamp(cloud.header.stamp);
            return Ok(Self { parts: point_cloud_parts(&cloud)?, stamp });
        }
        if type_name == Imu::DEFINITION.name {
            let imu: Imu = read(message)?;
            return Ok(Self { parts: vec![imu_part(&imu)], stamp: stamp(imu.header.stamp) });
        }
        if type_name == StringMessage::DEFINITION.name {
            let text: StringMessage = read(message)?;
            let description = Description::unshaped(MediaType::Text);
            return Ok(Self { parts: vec![Part { description, bytes: text.data.into() }], stamp: None });
        }
        // The receiver may know the type and decode the bytes.
        let part = Part { description: Description::bytes(), bytes: message.bytes.clone() };
        Ok(Self { parts: vec![part], stamp: None })
    }
}

fn read<M: Message>(message: &TopicMessage) -> Result<M, DecodeError> {
    M::decode(message.form, message.bytes.clone())
}

/// Converts a stamp. In ROS, zero means that the publisher set no time.
fn stamp(time: Time) -> Option<WallTime> {
    (time != Time::default()).then(|| WallTime::from_unix_nanos(time.as_nanos()))
}

/// Returns the media type for `format`, which is `jpeg` or `png`, or the text that image_transport writes:
/// `rgb8; jpeg compressed bgr8`.
fn media_type_of_format(format: &str) -> MediaType {
    let format = format.to_ascii_lowercase();
    // The text may name pixel encodings before and after the word `jpeg` or `png`.
    if format.contains("jpeg") || format.contains("jpg") {
        MediaType::Jpeg
    } else if format.contains("png") {
        MediaType::Png
    } else {
        MediaType::Bytes
    }
}

/// Returns two parts: the points (`height × width × point_step` bytes without padding), and a JSON document that
/// describes the bytes of a point.
fn point_cloud_parts(cloud: &PointCloud2) -> Result<Vec<Part>, PictureError> {
    let shape = vec![cloud.height, cloud.width, cloud.point_step];
    let rows = image::Rows {
        height: cloud.height,
        row_bytes: u64::from(cloud.width) * u64::from(cloud.point_step),
        step: cloud.row_step,
    };
    let fields: Vec<_> = cloud.fields.iter().map(describe_field).collect();
    let layout = json!({ "fields": fields, "big_endian": cloud.is_bigendian, "dense": cloud.is_dense });
    let description = Description { media: MediaType::Tensor, shape, element: Some(ElementType::U8) };
    Ok(vec![
        Part { description, bytes: rows.without_padding(&cloud.data)? },
        Part { description: Description::unshaped(MediaType::Json), bytes: layout.to_string().into() },
    ])
}

/// Describes a field of the points as JSON.
fn describe_field(field: &PointField) -> serde_json::Value {
    const TYPES: [&str; 8] = ["int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64"];
    // `PointField` numbers the types from 1.
    let type_name = usize::from(field.datatype).checked_sub(1).and_then(|index| TYPES.get(index)).copied();
    json!({ "name": field.name, "offset": field.offset, "type": type_name, "count": field.count })
}

/// Returns the 37 numbers of the message in its order: orientation (x, y, z, w) and its covariance, angular velocity
/// and its covariance, linear acceleration and its covariance.
fn imu_part(imu: &Imu) -> Part {
    let (q, v, a) = (imu.orientation, imu.angular_velocity, imu.linear_acceleration);
    let numbers = [q.x, q.y, q.z, q.w]
        .into_iter()
        .chain(imu.orientation_covariance)
        .chain([v.x, v.y, v.z])
        .chain(imu.angular_velocity_covariance)
        .chain([a.x, a.y, a.z])
        .chain(imu.linear_acceleration_covariance);
    let bytes: Vec<u8> = numbers.flat_map(f64::to_le_bytes).collect();
    let shape = vec![37];
    let description = Description { media: MediaType::Tensor, shape, element: Some(ElementType::F64) };
    Part { description, bytes: bytes.into() }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use bytes::Bytes;
    use peernet_ros::messages::{Header, WireForm};

    use super::*;

    /// Encodes a message and converts it to a payload.
    fn convert<M: Message>(message: &M, form: WireForm) -> Payload {
        let bytes = message.encode(form).expect("can be encoded").into_bytes();
        let received = WallTime::from_unix_nanos(0);
        let type_name: Arc<str> = M::DEFINITION.name.into();
        Payload::decode(&TopicMessage { form, type_name, bytes, received, dropped: 0 }).expect("is a sample")
    }

    fn header() -> Header {
        Header { seq: 3, stamp: Time { sec: 12, nanosec: 34 }, frame_id: "map".into() }
    }

    #[test]
    fn image_text_and_imu_are_decoded_in_both_wire_forms() {
        for form in [WireForm::Ros1, WireForm::Cdr] {
            let file = CompressedImage {
                header: header(),
                format: "rgb8; jpeg compressed bgr8".into(),
                data: "file".into(),
            };
            let payload = convert(&file, form);
            assert_eq!(payload.parts[0].description.media, MediaType::Jpeg);
            assert_eq!(payload.parts[0].bytes, "file");
            assert_eq!(payload.stamp, Some(WallTime::from_unix_nanos(12_000_000_034)));

            let text = convert(&StringMessage { data: "left".into() }, form);
            assert_eq!((text.parts[0].bytes.as_ref(), text.stamp), (&b"left"[..], None));

            let mut imu = Imu { header: header(), ..Imu::default() };
            imu.linear_acceleration_covariance[8] = 2.5;
            let part = convert(&imu, form).parts.remove(0);
            assert_eq!(part.description.shaped_bytes(), Some(part.bytes.len() as u64));
            assert_eq!(part.bytes[36 * 8..], 2.5_f64.to_le_bytes());
        }
    }

    #[test]
    fn point_cloud_loses_padding_and_keeps_description() {
        let fields = vec![PointField { name: "x".into(), offset: 0, datatype: 7, count: 1 }];
        let data = Bytes::from_static(b"aaaabbbb....ccccdddd....");
        let cloud = PointCloud2 {
            height: 2,
            width: 2,
            fields,
            point_step: 4,
            row_step: 12,
            data,
            ..PointCloud2::default()
        };
        let payload = convert(&cloud, WireForm::Ros1);
        assert_eq!(payload.parts[0].bytes, "aaaabbbbccccdddd");
        assert_eq!(payload.parts[0].description.shape, [2, 2, 4]);
        let layout: serde_json::Value = serde_json::from_slice(&payload.parts[1].bytes).expect("is JSON");
        assert_eq!((&layout["fields"][0]["type"], &layout["big_endian"]), (&"float32".into(), &false.into()));
        // The publisher set no time.
        assert_eq!(payload.stamp, None);
    }

    #[test]
    fn message_of_other_type_becomes_bytes() {
        let (form, bytes) = (WireForm::Ros1, Bytes::from_static(&[1, 2, 3]));
        let type_name: Arc<str> = "nav_msgs/Odometry".into();
        let received = WallTime::from_unix_nanos(0);
        let message = TopicMessage { form, type_name, bytes: bytes.clone(), received, dropped: 0 };
        let payload = Payload::decode(&message).expect("is a sample");
        assert_eq!((&payload.parts[0].description, &payload.parts[0].bytes), (&Description::bytes(), &bytes));
        // The same bytes are not a valid picture.
        let message = TopicMessage { type_name: "sensor_msgs/Image".into(), ..message };
        assert!(matches!(Payload::decode(&message), Err(PayloadError::Decode(_))));
    }
}
